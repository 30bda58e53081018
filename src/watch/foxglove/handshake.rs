//! The opening of a connection: a request of HTTP that asks for a WebSocket. Pure text in, text out.

use std::net::SocketAddr;

use tungstenite::handshake::derive_accept_key;

use super::super::web::request::{PageResponse, answer, head};

/// The subprotocols that viewers ask for; what is sent is the same.
const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Most header fields of a request.
const MOST_FIELDS: usize = 64;

/// What a request leads to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Opening {
    /// It is not complete yet.
    NotYet,
    /// The answer after which the connection is a WebSocket.
    Accepted(String),
    /// The answer after which it is closed.
    Refused(String),
}

/// The answer to a request whose first bytes are `bytes`, to a server at `local` that lets in whoever has `token`.
pub(super) fn open(bytes: &[u8], local: SocketAddr, token: Option<&str>) -> Opening {
    let refused = |status: &str, text: &str| {
        let head = head(status, "text/plain; charset=utf-8", Some(text.len() + 1));
        Opening::Refused(format!("{head}{text}\n"))
    };
    match answer(bytes, local, token) {
        PageResponse::NotYet => return Opening::NotYet,
        PageResponse::Refusal(status, text) => return refused(status, text),
        PageResponse::Page { .. } | PageResponse::Events | PageResponse::Metrics { .. } => {}
    }
    let mut fields = [httparse::EMPTY_HEADER; MOST_FIELDS];
    let mut request = httparse::Request::new(&mut fields);
    let _ = request.parse(bytes);
    let field = |name: &str| {
        let field = request.headers.iter().find(|field| field.name.eq_ignore_ascii_case(name))?;
        std::str::from_utf8(field.value).ok()
    };
    let Some(key) = field("sec-websocket-key").filter(|_| field("sec-websocket-version") == Some("13")) else {
        let text = "This is the Foxglove WebSocket protocol: open it in Foxglove, Lichtblick or PlotJuggler.";
        return refused("426 Upgrade Required", text);
    };
    let offered = field("sec-websocket-protocol").unwrap_or_default();
    let Some(chosen) = SUBPROTOCOLS.iter().find(|known| offered.split(',').any(|name| name.trim() == **known)) else {
        return refused("400 Bad Request", "Ask for the subprotocol foxglove.websocket.v1 or foxglove.sdk.v1.");
    };
    Opening::Accepted(format!(
        "HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Accept: \
         {}\r\nSec-WebSocket-Protocol: {chosen}\r\n\r\n",
        derive_accept_key(key.as_bytes())
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn viewers_are_let_in_by_either_name_and_others_are_told_why_not() {
        let local = "127.0.0.1:8765".parse().unwrap();
        let ask = |host: &str, more: &str| {
            open(format!("GET / HTTP/1.1\r\nHost: {host}\r\n{more}\r\n").as_bytes(), local, None)
        };
        // The key and its answer are the example of RFC 6455.
        let socket = "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
        for name in SUBPROTOCOLS {
            let asked = format!("{socket}Sec-WebSocket-Protocol: x, {name}\r\n");
            let Opening::Accepted(head) = ask("localhost:8765", &asked) else {
                panic!("{name} is refused");
            };
            assert!(head.contains("s3pPLMBiTxaQ9kYGzzhZRbK+xOo=") && head.contains(&format!("Protocol: {name}\r\n")));
        }
        for (host, more, status) in
            [("localhost:8765", "", "426"), ("localhost:8765", socket, "400"), ("elsewhere.example", socket, "403")]
        {
            let Opening::Refused(text) = ask(host, more) else { panic!("{host} {more} is let in") };
            assert!(text.starts_with(&format!("HTTP/1.1 {status}")), "{text}");
        }
        assert_eq!(open(b"GET / HT", local, None), Opening::NotYet);
    }
}

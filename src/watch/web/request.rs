//! Requests: their heads, who may ask, and what the answer is. Pure text in, text out.

use std::net::SocketAddr;

/// Longest head of a request, bytes.
pub(in crate::watch) const LONGEST_HEAD: usize = 8192;
/// Most header fields of a request.
const MOST_FIELDS: usize = 64;

/// The answer to a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::watch) enum PageResponse {
    /// The head is not complete yet.
    NotYet,
    /// The page; without its body if the method was HEAD.
    Page {
        /// Whether only the head was asked for.
        head: bool,
    },
    /// Server-sent events.
    Events,
    /// Metrics for Prometheus; without the body if the method was HEAD.
    Metrics {
        /// Whether only the head was asked for.
        head: bool,
    },
    /// A refusal: status line and one sentence.
    Refusal(&'static str, &'static str),
}

/// The answer to the request whose first bytes are `bytes`. The page is served at `local`, to whoever has `token`.
pub(in crate::watch) fn answer(bytes: &[u8], local: SocketAddr, token: Option<&str>) -> PageResponse {
    let mut fields = [httparse::EMPTY_HEADER; MOST_FIELDS];
    let mut request = httparse::Request::new(&mut fields);
    match request.parse(bytes) {
        Ok(httparse::Status::Complete(_)) => {}
        Ok(httparse::Status::Partial) if bytes.len() < LONGEST_HEAD => return PageResponse::NotYet,
        Ok(httparse::Status::Partial) => {
            return PageResponse::Refusal("431 Request Header Fields Too Large", "The request is too long.");
        }
        Err(_) => return PageResponse::Refusal("400 Bad Request", "This is no request of HTTP."),
    }
    let head = request.method == Some("HEAD");
    if !head && request.method != Some("GET") {
        return PageResponse::Refusal("405 Method Not Allowed", "Nothing here can be changed.");
    }
    let (path, query) = split_query(request.path.unwrap_or_default());
    let host = request.headers.iter().find(|field| field.name.eq_ignore_ascii_case("host"));
    let host = host.and_then(|field| std::str::from_utf8(field.value).ok()).unwrap_or_default();
    match token {
        None if !names_this_machine(host, local) => {
            return PageResponse::Refusal("403 Forbidden", "This page is for this machine alone; open it as printed.");
        }
        Some(token) if !query.split('&').any(|pair| pair.strip_prefix("token=") == Some(token)) => {
            return PageResponse::Refusal("403 Forbidden", "The token is missing or wrong; open the link as printed.");
        }
        _ => {}
    }
    match path {
        "/" => PageResponse::Page { head },
        "/events" if !head => PageResponse::Events,
        "/metrics" => PageResponse::Metrics { head },
        _ => PageResponse::Refusal("404 Not Found", "There is nothing here; the page is at /, metrics at /metrics."),
    }
}

fn split_query(target: &str) -> (&str, &str) {
    target.split_once('?').unwrap_or((target, ""))
}

/// Whether a request's host is one that only a reader on this machine can mean.
fn names_this_machine(host: &str, local: SocketAddr) -> bool {
    let (name, port) = match host.rsplit_once(':') {
        Some((name, port)) if !port.ends_with(']') => (name, port.parse().ok()),
        _ => (host, Some(80)),
    };
    let name = name.trim_start_matches('[').trim_end_matches(']');
    let is_loopback = name.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback());
    (name == "localhost" || is_loopback) && port == Some(local.port())
}

/// The head of an answer with a body of `length` bytes, or of events if that is `None`.
pub(in crate::watch) fn head(status: &str, kind: &str, length: Option<usize>) -> String {
    let length = length.map_or(String::new(), |length| format!("Content-Length: {length}\r\nConnection: close\r\n"));
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\n{length}Cache-Control: no-store\r\nReferrer-Policy: \
         no-referrer\r\nX-Content-Type-Options: nosniff\r\nContent-Security-Policy: default-src 'none'; script-src \
         'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src data:; frame-ancestors \
         'none'\r\n\r\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(text: &str, token: Option<&str>) -> PageResponse {
        answer(text.as_bytes(), "127.0.0.1:8417".parse().unwrap(), token)
    }

    #[test]
    fn this_machine_may_read_and_other_names_for_it_may_not() {
        for host in ["localhost:8417", "127.0.0.1:8417", "[::1]:8417"] {
            assert_eq!(
                ask(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n"), None),
                PageResponse::Page { head: false }
            );
        }
        for host in ["evil.example:8417", "localhost:80", "localhost", "", "127.0.0.1.evil.example:8417"] {
            let answer = ask(&format!("GET /events HTTP/1.1\r\nhost: {host}\r\n\r\n"), None);
            assert!(matches!(answer, PageResponse::Refusal("403 Forbidden", _)), "{host}: {answer:?}");
        }
    }

    #[test]
    fn another_machine_needs_the_token() {
        let with = |target: &str| ask(&format!("GET {target} HTTP/1.1\r\nHost: robot:8417\r\n\r\n"), Some("5e"));
        assert_eq!(with("/?token=5e"), PageResponse::Page { head: false });
        assert_eq!(with("/events?x=1&token=5e"), PageResponse::Events);
        assert_eq!(with("/metrics?token=5e"), PageResponse::Metrics { head: false });
        for target in ["/", "/?token=", "/?token=5", "/?token=5e5e", "/events?tok=5e", "/events", "/metrics"] {
            assert!(matches!(with(target), PageResponse::Refusal("403 Forbidden", _)), "{target}");
        }
    }

    #[test]
    fn what_is_no_request_is_refused_and_what_is_not_whole_is_waited_for() {
        let host = "HTTP/1.1\r\nHost: localhost:8417\r\n\r\n";
        assert_eq!(ask("GET / HTTP/1.1\r\nHo", None), PageResponse::NotYet);
        assert_eq!(ask(&format!("HEAD / {host}"), None), PageResponse::Page { head: true });
        for (text, status) in [
            ("\x16\x03\x01hello".to_owned(), "400"),
            (format!("POST / {host}"), "405"),
            (format!("GET /../etc/passwd {host}"), "404"),
            (format!("GET /{}", "x".repeat(LONGEST_HEAD)), "431"),
        ] {
            let PageResponse::Refusal(found, _) = ask(&text, None) else { panic!("{text}") };
            assert!(found.starts_with(status), "{found} for {text}");
        }
    }
}

//! Messages of the Foxglove WebSocket protocol, as far as a server needs them that sends and takes nothing.

use serde_json::{Value, json};

/// A channel, as it is advertised.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct FoxgloveChannel {
    pub id: u32,
    pub topic: String,
    pub encoding: &'static str,
    pub schema_name: String,
    pub schema_encoding: &'static str,
    pub schema: String,
}

/// What a client asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum ClientRequest {
    /// Messages of channels: pairs of subscription and channel.
    Subscribe(Vec<(u32, u32)>),
    /// No more messages for these subscriptions.
    Unsubscribe(Vec<u32>),
}

/// The first message of a connection, and of each new run.
pub(super) fn server_info(name: &str, session: &str) -> String {
    let metadata = json!({"build": crate::BUILD});
    let info =
        json!({"op": "serverInfo", "name": name, "capabilities": [], "metadata": metadata, "sessionId": session});
    info.to_string()
}

pub(super) fn advertise(channels: &[FoxgloveChannel]) -> String {
    let each = channels.iter().map(|channel| {
        json!({
            "id": channel.id, "topic": channel.topic, "encoding": channel.encoding, "schemaName": channel.schema_name,
            "schemaEncoding": channel.schema_encoding, "schema": channel.schema,
        })
    });
    json!({"op": "advertise", "channels": each.collect::<Vec<_>>()}).to_string()
}

pub(super) fn unadvertise(ids: &[u32]) -> String {
    json!({"op": "unadvertise", "channelIds": ids}).to_string()
}

/// A sentence for the viewer's list of problems. One with the same `id` takes its place.
pub(super) fn status(warning: bool, id: &str, text: &str) -> String {
    json!({"op": "status", "level": u8::from(warning), "message": text, "id": id}).to_string()
}

/// A message of a channel.
pub(super) fn message_data(subscription: u32, ns: u64, data: &[u8]) -> Vec<u8> {
    [&[1_u8][..], &subscription.to_le_bytes(), &ns.to_le_bytes(), data].concat()
}

/// What a client's text asks for. `Ok(None)` if it is of no concern: this server has no parameters, services or assets.
///
/// # Errors
/// One sentence, if it is no message of the protocol.
pub(super) fn request(text: &str) -> Result<Option<ClientRequest>, String> {
    let message: Value = serde_json::from_str(text).map_err(|error| format!("A message is not JSON: {error}."))?;
    let number = |value: &Value| value.as_u64().and_then(|n| u32::try_from(n).ok());
    let list = |key: &str| message[key].as_array().ok_or_else(|| format!("A message has no list \"{key}\"."));
    match message["op"].as_str() {
        Some("subscribe") => {
            let pair = |value: &Value| Some((number(&value["id"])?, number(&value["channelId"])?));
            let pairs = list("subscriptions")?.iter().map(pair).collect::<Option<_>>();
            pairs.map(|pairs| Some(ClientRequest::Subscribe(pairs))).ok_or("A subscription lacks a number.".to_owned())
        }
        Some("unsubscribe") => {
            let ids = list("subscriptionIds")?.iter().map(number).collect::<Option<_>>();
            ids.map(|ids| Some(ClientRequest::Unsubscribe(ids))).ok_or("A subscription is no number.".to_owned())
        }
        Some(_) => Ok(None),
        None => Err("A message has no \"op\".".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_and_nonsense_is_named() {
        let subscribe = r#"{"op": "subscribe", "subscriptions": [{"id": 3, "channelId": 1001}]}"#;
        assert_eq!(request(subscribe), Ok(Some(ClientRequest::Subscribe(vec![(3, 1001)]))));
        let unsubscribe = r#"{"op": "unsubscribe", "subscriptionIds": [3]}"#;
        assert_eq!(request(unsubscribe), Ok(Some(ClientRequest::Unsubscribe(vec![3]))));
        assert_eq!(request(r#"{"op": "getParameters"}"#), Ok(None));
        for text in ["", "{}", r#"{"op": "subscribe"}"#, r#"{"op": "unsubscribe", "subscriptionIds": ["x"]}"#] {
            assert!(request(text).is_err(), "{text}");
        }
        assert_eq!(message_data(1, 2, b"x"), [&[1, 1, 0, 0, 0, 2][..], &[0; 7], b"x"].concat());
    }
}

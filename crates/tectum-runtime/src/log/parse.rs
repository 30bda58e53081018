//! Parses the bodies of the few MCAP record types that a log holds, without trusting any of their bytes.
//!
//! The `mcap` crate frames records and checks checksums. Its own parser for bodies indexes past the end of a
//! short attachment, and reserves as much memory as a length field states, so a damaged file could crash the
//! reader. Here the result for a body that is too short is `None`.

use std::collections::BTreeMap;

/// Operation codes of the MCAP specification.
pub(super) mod op {
    pub const HEADER: u8 = 0x01;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const ATTACHMENT: u8 = 0x09;
    pub const METADATA: u8 = 0x0C;
    pub const DATA_END: u8 = 0x0F;
}

/// Reads little-endian fields off the front of a record's body.
struct FieldReader<'a>(&'a [u8]);

impl<'a> FieldReader<'a> {
    fn bytes(&mut self, n: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(n)?;
        self.0 = tail;
        Some(head)
    }

    fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(self.bytes(2)?.try_into().ok()?))
    }

    fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.bytes(4)?.try_into().ok()?))
    }

    fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.bytes(8)?.try_into().ok()?))
    }

    fn text(&mut self) -> Option<&'a str> {
        let n = self.u32()?;
        std::str::from_utf8(self.bytes(n as usize)?).ok()
    }

    fn map(&mut self) -> Option<BTreeMap<String, String>> {
        let n = self.u32()?;
        let mut entries = FieldReader(self.bytes(n as usize)?);
        let mut map = BTreeMap::new();
        while !entries.0.is_empty() {
            map.insert(entries.text()?.to_owned(), entries.text()?.to_owned());
        }
        Some(map)
    }
}

/// A schema's id, name, encoding and text.
pub(super) fn schema(body: &[u8]) -> Option<(u16, &str, &str, &[u8])> {
    let mut f = FieldReader(body);
    let (id, name, encoding, n) = (f.u16()?, f.text()?, f.text()?, f.u32()?);
    Some((id, name, encoding, f.bytes(n as usize)?))
}

/// A channel.
pub(super) struct ChannelRecord<'a> {
    pub id: u16,
    pub schema: u16,
    pub topic: &'a str,
    /// Encoding of its messages.
    pub encoding: &'a str,
    pub metadata: BTreeMap<String, String>,
}

pub(super) fn channel(body: &[u8]) -> Option<ChannelRecord<'_>> {
    let mut f = FieldReader(body);
    Some(ChannelRecord { id: f.u16()?, schema: f.u16()?, topic: f.text()?, encoding: f.text()?, metadata: f.map()? })
}

/// A message. Its sequence number and times repeat those of the sample's own header.
#[derive(Debug, PartialEq)]
pub(super) struct MessageRecord<'a> {
    pub channel: u16,
    pub sequence: u32,
    pub log_time: u64,
    pub publish_time: u64,
    pub data: &'a [u8],
}

pub(super) fn message(body: &[u8]) -> Option<MessageRecord<'_>> {
    let mut f = FieldReader(body);
    let (channel, sequence, log_time, publish_time) = (f.u16()?, f.u32()?, f.u64()?, f.u64()?);
    Some(MessageRecord { channel, sequence, log_time, publish_time, data: f.0 })
}

/// A chunk of records.
pub(super) struct ChunkRecord<'a> {
    /// Bytes of the records, unpacked.
    pub size: u64,
    /// How they are packed; empty if they are not.
    pub compression: &'a str,
    pub records: &'a [u8],
}

pub(super) fn chunk(body: &[u8]) -> Option<ChunkRecord<'_>> {
    let mut f = FieldReader(body);
    // First and last time of its messages; the checksum of its records is covered by that of the data section.
    let (_, _, size, _) = (f.u64()?, f.u64()?, f.u64()?, f.u32()?);
    let (compression, n) = (f.text()?, f.u64()?);
    Some(ChunkRecord { size, compression, records: f.bytes(usize::try_from(n).ok()?)? })
}

/// The profile and the library that the file's header names.
pub(super) fn header(body: &[u8]) -> Option<(&str, &str)> {
    let mut f = FieldReader(body);
    Some((f.text()?, f.text()?))
}

/// A metadata record's name and content.
pub(super) fn metadata(body: &[u8]) -> Option<(&str, BTreeMap<String, String>)> {
    let mut f = FieldReader(body);
    Some((f.text()?, f.map()?))
}

/// An attachment.
#[derive(Debug, PartialEq)]
pub(super) struct AttachmentRecord<'a> {
    pub log_time: u64,
    pub create_time: u64,
    pub name: &'a str,
    pub media_type: &'a str,
    pub data: &'a [u8],
}

pub(super) fn attachment(body: &[u8]) -> Option<AttachmentRecord<'_>> {
    let mut f = FieldReader(body);
    let (log_time, create_time, name, media_type, n) = (f.u64()?, f.u64()?, f.text()?, f.text()?, f.u64()?);
    let data = f.bytes(usize::try_from(n).ok()?)?;
    // The attachment's own checksum is covered by that of the whole data section.
    f.u32()?;
    Some(AttachmentRecord { log_time, create_time, name, media_type, data })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_length_fields_are_refused() {
        assert_eq!(metadata(&[0xff; 8]), None);
        let mut body = vec![1, 0, 0, 0, b'n'];
        body.extend([13, 0, 0, 0, 1, 0, 0, 0, b'k', 4, 0, 0, 0]);
        assert_eq!(metadata(&body), None, "the map is longer than the body");
        body.extend(*b"four");
        assert_eq!(metadata(&body), Some(("n", BTreeMap::from([("k".to_owned(), "four".to_owned())]))));
        assert_eq!(message(&[0; 21]), None);
        let empty = MessageRecord { channel: 0, sequence: 0, log_time: 0, publish_time: 0, data: &[] };
        assert_eq!(message(&[0; 22]), Some(empty));
        assert_eq!(attachment(&[0; 20]), None);
    }
}

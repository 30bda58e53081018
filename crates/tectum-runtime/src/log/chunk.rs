//! The records inside a chunk of a packed log.
//!
//! Nothing of a chunk is trusted: not the size that it states, nor the lengths of its records.

use super::parse;

/// Largest size of a chunk's records, bytes. Ours are smaller; no more is reserved for any that states more.
const MAX_CHUNK: usize = 64 * 1024 * 1024;

/// The unpacked records of a chunk.
pub(super) struct ChunkRecords {
    records: Vec<u8>,
    at: usize,
}

impl ChunkRecords {
    /// Unpacks the chunk record with this body.
    ///
    /// # Errors
    ///
    /// What is wrong with the chunk.
    pub fn unpack(body: &[u8]) -> Result<Self, &'static str> {
        let chunk = parse::chunk(body).ok_or("a chunk is cut short")?;
        let size = usize::try_from(chunk.size).ok().filter(|&size| size <= MAX_CHUNK);
        let size = size.ok_or("a chunk is larger than any of a log")?;
        let records = match chunk.compression {
            "" => chunk.records.to_vec(),
            "zstd" => zstd::bulk::decompress(chunk.records, size).map_err(|_| "a chunk cannot be unpacked")?,
            _ => return Err("a chunk is packed with something else than zstd; pack the log with zstd or not at all"),
        };
        if records.len() != size {
            return Err("a chunk has another size than it states");
        }
        Ok(Self { records, at: 0 })
    }

    /// Operation code and body of the next record.
    pub fn next_record(&mut self) -> Option<Result<(u8, &[u8]), &'static str>> {
        let rest = &self.records[self.at..];
        if rest.is_empty() {
            return None;
        }
        let Some((head, rest)) = rest.split_at_checked(9) else { return Some(Err("a chunk ends within a record")) };
        let [opcode, length @ ..] = head else { return None };
        let length = length.try_into().map_or(u64::MAX, u64::from_le_bytes);
        match usize::try_from(length).ok().and_then(|length| rest.get(..length)) {
            None => Some(Err("a chunk ends within a record")),
            Some(body) => {
                self.at += 9 + body.len();
                Some(Ok((*opcode, body)))
            }
        }
    }
}

//! Frames: a kind, a length, and as many bytes.

use std::io::{Error, ErrorKind, Read, Result, Write};

/// Longest frame, bytes.
pub(super) const MAX_FRAME: u32 = 16 << 20;

/// Kind and length from a frame's first bytes.
pub(super) fn head(bytes: [u8; 8]) -> (u32, u32) {
    let [kind, len] = [&bytes[..4], &bytes[4..]].map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    (kind, len)
}

/// Writes a frame.
pub(super) fn write_frame(to: &mut impl Write, kind: u32, bytes: &[u8]) -> Result<()> {
    to.write_all(&kind.to_le_bytes())?;
    to.write_all(&(bytes.len() as u32).to_le_bytes())?;
    to.write_all(bytes)?;
    to.flush()
}

/// The next frame; `None` at the end of the pipe.
pub(super) fn read_frame(from: &mut impl Read) -> Result<Option<(u32, Vec<u8>)>> {
    let mut first = [0; 8];
    match from.read_exact(&mut first) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        other => other?,
    }
    let (kind, len) = head(first);
    if len > MAX_FRAME {
        return Err(Error::other(format!("a frame of {len} bytes")));
    }
    let mut bytes = vec![0; len as usize];
    from.read_exact(&mut bytes)?;
    Ok(Some((kind, bytes)))
}

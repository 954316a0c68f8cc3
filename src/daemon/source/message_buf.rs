//! The buffer of a message: key, encoding and payload. After it is dropped, a later message reuses it.

use crossbeam_channel::{Receiver, Sender};

/// Most free buffers kept: more than wait for an engine that keeps up.
const READY: usize = 1024;
/// Larger buffers are not kept, bytes.
const MAX_KEPT: usize = 16 << 10;

/// The pool of buffers; clones share it.
#[derive(Debug, Clone)]
pub struct BufferPool {
    back: Sender<Vec<u8>>,
    ready: Receiver<Vec<u8>>,
}

/// One message's key, encoding and payload.
#[derive(Debug)]
pub struct MessageBuf {
    bytes: Vec<u8>,
    key: usize,
    /// End of the encoding, if the message has one.
    encoding: Option<usize>,
    back: Sender<Vec<u8>>,
}

impl Default for BufferPool {
    fn default() -> Self {
        let (back, ready) = crossbeam_channel::bounded(READY);
        Self { back, ready }
    }
}

impl BufferPool {
    /// Packs a message; `payload` appends its bytes.
    #[must_use]
    pub fn pack(&self, key: &str, encoding: Option<&str>, payload: impl FnOnce(&mut Vec<u8>)) -> MessageBuf {
        let mut bytes = self.ready.try_recv().unwrap_or_default();
        bytes.extend_from_slice(key.as_bytes());
        bytes.extend_from_slice(encoding.unwrap_or_default().as_bytes());
        let encoding = encoding.map(|_| bytes.len());
        payload(&mut bytes);
        MessageBuf { bytes, key: key.len(), encoding, back: self.back.clone() }
    }
}

impl MessageBuf {
    /// The key.
    #[must_use]
    pub fn key(&self) -> &str {
        std::str::from_utf8(&self.bytes[..self.key]).unwrap_or_default()
    }

    /// The encoding stated by the message, if any.
    #[must_use]
    pub fn encoding(&self) -> Option<&str> {
        Some(std::str::from_utf8(&self.bytes[self.key..self.encoding?]).unwrap_or_default())
    }

    /// The payload.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        &self.bytes[self.encoding.unwrap_or(self.key)..]
    }
}

impl Drop for MessageBuf {
    fn drop(&mut self) {
        let mut bytes = std::mem::take(&mut self.bytes);
        if bytes.capacity() <= MAX_KEPT {
            bytes.clear();
            // If enough free buffers are kept, this one is dropped.
            let _ = self.back.try_send(bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parcel_gives_back_what_was_packed_and_its_buffer_is_used_again() {
        let pool = BufferPool::default();
        let packed = pool.pack("p/A/op", Some("application/json"), |bytes| bytes.extend_from_slice(b"1.5"));
        let place = packed.bytes.as_ptr();
        assert_eq!(
            (packed.key(), packed.encoding(), packed.payload()),
            ("p/A/op", Some("application/json"), &b"1.5"[..])
        );
        drop(packed);
        let again = pool.pack("p/B/pv", None, |_| {});
        assert_eq!((again.key(), again.encoding(), again.payload()), ("p/B/pv", None, &b""[..]));
        assert_eq!(again.bytes.as_ptr(), place);
        drop(pool.pack("p", None, |bytes| bytes.resize(MAX_KEPT + 1, 0)));
        assert_eq!(pool.ready.len(), 0);
    }
}

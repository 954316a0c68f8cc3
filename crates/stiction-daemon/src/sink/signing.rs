//! Signs documents, so that a consumer can tell the daemon's from others' under the same keys.
//!
//! A signed document carries a Zenoh attachment, `{"alg":"ed25519","key":HEX,"sig":HEX}`: the signature of its key, a zero
//! byte, and the document as it was sent. The document itself is what it is without. A consumer that knows the public
//! key beforehand (the log names it at the start) needs nothing else; it must not trust the one in the attachment.

use std::path::Path;

use anyhow::{Context, anyhow};
use ring::signature::{ED25519, Ed25519KeyPair, KeyPair, UnparsedPublicKey};
use serde::{Deserialize, Serialize};

/// Largest key file that is read, bytes: a PKCS#8 document of Ed25519 has less than a hundred.
const MAX_KEY_BYTES: u64 = 4096;

/// What signs.
pub struct Signer {
    pair: Ed25519KeyPair,
}

/// What goes along with a signed document.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Signature {
    /// `ed25519`.
    pub alg: String,
    /// The public key, in hex.
    pub key: String,
    /// The signature, in hex.
    pub sig: String,
}

impl Signer {
    /// Reads a private key.
    ///
    /// # Errors
    /// The file cannot be read, or is no Ed25519 key in PKCS#8 DER.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let name = || path.display().to_string();
        let size = std::fs::metadata(path).with_context(name)?.len();
        let bytes = if size > MAX_KEY_BYTES { Vec::new() } else { std::fs::read(path).with_context(name)? };
        let pair = Ed25519KeyPair::from_pkcs8_maybe_unchecked(&bytes).map_err(|e| {
            let remedy = "make one with: openssl genpkey -algorithm ed25519 -outform DER -out FILE";
            anyhow!("{}: no Ed25519 key in PKCS#8 DER ({e}); {remedy}", path.display())
        })?;
        Ok(Self { pair })
    }

    /// The public key, in hex.
    #[must_use]
    pub fn public_key(&self) -> String {
        hex(self.pair.public_key().as_ref())
    }

    /// The attachment of a document that is sent under a key.
    #[must_use]
    pub fn attachment(&self, key: &str, document: &[u8]) -> Vec<u8> {
        let signature = self.pair.sign(&signed(key, document));
        let all = Signature { alg: "ed25519".into(), key: self.public_key(), sig: hex(signature.as_ref()) };
        serde_json::to_vec(&all).unwrap_or_default()
    }
}

impl Signature {
    /// Whether a document under a key is by the owner of this public key.
    #[must_use]
    pub fn holds(&self, public_key: &str, key: &str, document: &[u8]) -> bool {
        let (Some(public), Some(sig)) = (unhex(public_key), unhex(&self.sig)) else { return false };
        self.key == public_key && UnparsedPublicKey::new(&ED25519, public).verify(&signed(key, document), &sig).is_ok()
    }
}

fn signed(key: &str, document: &[u8]) -> Vec<u8> {
    [key.as_bytes(), &[0], document].concat()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(text: &str) -> Option<Vec<u8>> {
    let digits = text.as_bytes().chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok());
    if text.len().is_multiple_of(2) { digits.collect() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A PKCS#8 document around a seed, as openssl writes it.
    fn signer(dir: &Path, seed: u8) -> Signer {
        let path = dir.join(format!("{seed}.der"));
        let head = [0x30, 0x2e, 2, 1, 0, 0x30, 5, 6, 3, 0x2b, 0x65, 0x70, 4, 0x22, 4, 0x20];
        std::fs::write(&path, [&head[..], &[seed; 32]].concat()).unwrap();
        Signer::read(&path).unwrap()
    }

    #[test]
    fn a_signature_holds_for_its_key_document_and_signer_alone() {
        let dir = tempfile::tempdir().unwrap();
        let (ours, other) = (signer(dir.path(), 7), signer(dir.path(), 8));
        let signature: Signature = serde_json::from_slice(&ours.attachment("p/alarm", b"{}")).unwrap();
        assert!(signature.holds(&ours.public_key(), "p/alarm", b"{}"));
        assert!(!signature.holds(&ours.public_key(), "p/alarm", b"{ }"));
        assert!(!signature.holds(&ours.public_key(), "q/alarm", b"{}"));
        assert!(!signature.holds(&other.public_key(), "p/alarm", b"{}"));
        let forged: Signature = serde_json::from_slice(&other.attachment("p/alarm", b"{}")).unwrap();
        assert!(!forged.holds(&ours.public_key(), "p/alarm", b"{}"));
        std::fs::write(dir.path().join("bad"), b"-----BEGIN").unwrap();
        let said = Signer::read(&dir.path().join("bad")).err().unwrap().to_string();
        assert!(said.contains("openssl genpkey"), "{said}");
    }
}

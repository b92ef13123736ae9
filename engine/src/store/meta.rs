//! Free text about a volume: the only user of the serializer crate. Readers may skip the record;
//! nothing that is needed to read samples is in it.

use super::layout::ATTR_BYTES_MAX;
use crate::error::{Error, ErrorKind, Result};
use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use serde::{Deserialize, Serialize};

/// Where a volume came from. Fields are only ever added at the end, with a new version.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct History {
    pub(crate) version: u32,
    pub(crate) text: String,
}

const CONFIG: Configuration<LittleEndian, Fixint, Limit<ATTR_BYTES_MAX>> =
    bincode::config::standard()
        .with_fixed_int_encoding()
        .with_limit::<ATTR_BYTES_MAX>();

/// # Errors
/// `LimitExceeded` for a text beyond 1 MiB.
pub(crate) fn encode(text: &str) -> Result<Vec<u8>> {
    let history = History {
        version: 1,
        text: text.into(),
    };
    let bytes = bincode::serde::encode_to_vec(&history, CONFIG)
        .map_err(|e| Error::bad_input(format!("the history text cannot be stored: {e}")))?;
    if bytes.len() > ATTR_BYTES_MAX {
        return Err(Error::new(
            ErrorKind::LimitExceeded,
            format!(
                "a history of {} bytes: at most {ATTR_BYTES_MAX}",
                bytes.len()
            ),
        ));
    }
    Ok(bytes)
}

/// The text; `None` when it is of a later version or malformed.
pub(crate) fn decode(bytes: &[u8]) -> Option<String> {
    let (history, used): (History, usize) =
        bincode::serde::decode_from_slice(bytes, CONFIG).ok()?;
    (used == bytes.len() && history.version == 1).then_some(history.text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn history_round_trip_and_empty() {
        for text in ["", "imported from tooth.nhdr", "höhe"] {
            assert_eq!(decode(&encode(text).expect("small")).as_deref(), Some(text));
        }
    }

    #[test]
    fn history_every_truncation_and_extra_bytes_and_wrong_version_and_huge_declared_size() {
        let mut bytes = encode("some text").expect("small");
        for end in 0..bytes.len() {
            assert_eq!(decode(&bytes[..end]), None);
        }
        bytes.push(0);
        assert_eq!(decode(&bytes), None);
        bytes.pop();
        let mut later = bytes.clone();
        later[0] = 2;
        assert_eq!(decode(&later), None);
        bytes[4..12].fill(0xff);
        assert_eq!(decode(&bytes), None);
        assert_eq!(
            encode(&"x".repeat(ATTR_BYTES_MAX + 1))
                .expect_err("too long")
                .kind(),
            ErrorKind::LimitExceeded
        );
    }
}

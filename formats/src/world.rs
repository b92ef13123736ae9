//! The names of world axes. A volume keeps the coordinates that its source stated; which way its axes
//! point is a phrase in the description, and from there in the history of the volume.

/// x to the right, y to the front, z up: NIfTI.
pub(crate) const RAS: &str = "right-anterior-superior";

/// x to the left, y to the back, z up: MetaImage, DICOM, most NRRD files.
pub(crate) const LPS: &str = "left-posterior-superior";

const LAS: &str = "left-anterior-superior";
const PHRASE: &str = "world is ";

/// The phrase for a space by the name that NRRD has for it.
pub(crate) fn phrase(space: &str) -> String {
    let short = space.trim().to_lowercase();
    let long = match short.as_str() {
        "ras" => RAS,
        "lps" => LPS,
        "las" => LAS,
        other => other,
    };
    format!("{PHRASE}{long}")
}

/// The anatomical space that the last phrase in `history` names, if it does.
pub(crate) fn space_of(history: &str) -> Option<&'static str> {
    let (_, name) = history.rsplit_once(PHRASE)?;
    [RAS, LPS, LAS].into_iter().find(|known| {
        name.strip_prefix(known)
            .is_some_and(|rest| !rest.starts_with('-'))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spaces_survive_in_a_history() {
        for (given, name) in [("LPS", LPS), ("ras", RAS), (LAS, LAS)] {
            let history = format!(
                "a, {}; b, {} by sform\nthen cropped",
                phrase("lps"),
                phrase(given)
            );
            assert_eq!(space_of(&history), Some(name));
        }
        for text in [
            "",
            "world is flat",
            &phrase("LPS-time"),
            &phrase("left-posterior-superior-time"),
        ] {
            assert_eq!(space_of(text), None, "{text}");
        }
    }
}

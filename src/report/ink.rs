//! Colours by meaning, the same in every picture, with a second set for dark screens.
//!
//! A picture contains the light colours, so that it can be printed or used separately; a page's style sheet replaces them by
//! attribute on dark screens.

use std::fmt::Write;

use plotters::style::RGBColor;

/// Meaning of a colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ink {
    /// Text and axes.
    Text,
    /// Less important text, ticks.
    Soft,
    /// Grid lines, frames of boxes.
    Faint,
    /// Background.
    Paper,
    /// Controller output.
    Op,
    /// Measured process variable.
    Pv,
    /// Set point.
    Sp,
    /// Valve position, measured or fitted.
    Mv,
    /// Output of a model.
    Fit,
    /// Residual of a model, and alarms.
    Error,
    /// A second model, or the earlier state.
    Other,
    /// Lines over a colour map.
    Over,
}

/// Every ink: CSS variable, light and dark colour.
const TABLE: [(Ink, &str, [u8; 3], [u8; 3]); 12] = [
    (Ink::Text, "--text", [0x1b, 0x24, 0x30], [0xe6, 0xea, 0xf0]),
    (Ink::Soft, "--soft", [0x55, 0x60, 0x6e], [0xa3, 0xae, 0xbc]),
    (Ink::Faint, "--faint", [0xdd, 0xe1, 0xe7], [0x36, 0x3f, 0x4b]),
    (Ink::Paper, "--paper", [0xff, 0xff, 0xfe], [0x15, 0x1a, 0x21]),
    (Ink::Op, "--op", [0xb4, 0x53, 0x09], [0xf3, 0xa3, 0x4e]),
    (Ink::Pv, "--pv", [0x1f, 0x4f, 0xbf], [0x7f, 0xac, 0xff]),
    (Ink::Sp, "--sp", [0x6b, 0x72, 0x80], [0x9a, 0xa3, 0xb2]),
    (Ink::Mv, "--mv", [0x7c, 0x3a, 0xed], [0xb9, 0x9b, 0xff]),
    (Ink::Fit, "--fit", [0x04, 0x78, 0x57], [0x4f, 0xd1, 0xa5]),
    (Ink::Error, "--error", [0xbe, 0x12, 0x3c], [0xff, 0x7d, 0x98]),
    (Ink::Other, "--other", [0xa1, 0x62, 0x07], [0xe8, 0xc4, 0x5c]),
    (Ink::Over, "--over", [0xff, 0xff, 0xff], [0xff, 0xff, 0xff]),
];

impl Ink {
    fn row(self) -> &'static (Self, &'static str, [u8; 3], [u8; 3]) {
        TABLE.iter().find(|row| row.0 == self).unwrap_or(&TABLE[0])
    }

    /// The light colour, as used in pictures.
    #[must_use]
    pub fn colour(self) -> RGBColor {
        let [r, g, b] = self.row().2;
        RGBColor(r, g, b)
    }

    /// The light colour in SVG notation.
    #[must_use]
    pub fn hex(self) -> String {
        hex(self.row().2)
    }
}

fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02X}{g:02X}{b:02X}")
}

/// Style sheet for pictures on a page or sheet: the dark set on dark screens, never in print.
#[must_use]
pub fn style() -> String {
    let (mut light, mut dark, mut swap) = (String::new(), String::new(), String::new());
    for (ink, name, day, night) in &TABLE {
        let _ = write!(light, "{name}:{};", hex(*day));
        let _ = write!(dark, "{name}:{};", hex(*night));
        if *ink != Ink::Over {
            let day = hex(*day);
            let _ = write!(
                swap,
                ".plot [fill=\"{day}\"]{{fill:var({name})}}.plot [stroke=\"{day}\"]{{stroke:var({name})}}"
            );
        }
    }
    format!(":root{{{light}}}@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}{swap}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_ink_has_a_colour_of_its_own() {
        for (k, row) in TABLE.iter().enumerate() {
            assert!(TABLE[..k].iter().all(|other| other.0 != row.0 && other.1 != row.1 && other.2 != row.2), "{row:?}");
            assert_eq!(row.0.hex(), hex(row.2));
        }
        let sheet = style();
        assert!(sheet.contains("--pv:#1F4FBF") && sheet.contains("[stroke=\"#1F4FBF\"]{stroke:var(--pv)}"));
    }
}

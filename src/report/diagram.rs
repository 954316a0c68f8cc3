//! Block diagram of the loop with its tags.

use maud::{PreEscaped, html};

use super::ink::Ink;
use super::plot::{FINE, Picture, shortened};

/// Names and units of a loop's signals; `None` where a signal is not in the record.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tags {
    /// Set point.
    pub sp: Option<String>,
    /// Controller output.
    pub op: String,
    /// Valve position.
    pub mv: Option<String>,
    /// Process variable.
    pub pv: String,
    /// Units of OP and PV, for axes.
    pub units: [String; 2],
}

impl Tags {
    /// Default names of a loop's signals without tags.
    #[must_use]
    pub fn of_loop(name: &str, sp: bool, mv: bool) -> Self {
        let tag = |signal: &str| format!("{name}.{signal}");
        let units = ["OP units", "PV units"].map(str::to_owned);
        Self { sp: sp.then(|| tag("SP")), op: tag("OP"), mv: mv.then(|| tag("MV")), pv: tag("PV"), units }
    }
}

const WIDTH: u32 = 760;
const HEIGHT: u32 = 150;
/// Letters of a tag that fit below an arrow.
const LETTERS: usize = 15;

/// Draws SP, controller, OP, valve, MV, process, PV and the feedback.
#[must_use]
pub fn loop_diagram(tags: &Tags) -> Picture {
    let unknown = "not recorded".to_owned();
    let arrows = [
        (2, 62, "SP", tags.sp.as_ref().unwrap_or(&unknown), Ink::Sp),
        (242, 332, "OP", &tags.op, Ink::Op),
        (422, 512, "MV", tags.mv.as_ref().unwrap_or(&unknown), Ink::Mv),
        (602, 742, "PV", &tags.pv, Ink::Pv),
    ];
    let boxes = [(142, "Controller"), (332, "Valve"), (512, "Process")];
    let line = Ink::Soft.hex();
    let body = html! {
        g transform=(format!("scale({FINE})")) font-size="13" fill=(Ink::Text.hex()) {
            circle cx="76" cy="50" r="14" fill="none" stroke=(line) stroke-width="1.5" {}
            text x="76" y="55" text-anchor="middle" { "\u{2212}" }
            (arrow(90, 142, &line))
            @for (x, name) in boxes {
                @let wide = if name == "Controller" { 100 } else { 90 };
                rect x=(x) y="28" width=(wide) height="44" rx="5" fill="none" stroke=(line) stroke-width="1.5" {}
                text x=(x + wide / 2) y="55" text-anchor="middle" { (name) }
            }
            @for (from, to, name, tag, ink) in arrows {
                // SP's tag is placed above the arrow, where it is clear; PV's keeps clear of the feedback line.
                @let (middle, anchor, y) = match name {
                    "SP" => (4, "start", 20),
                    "PV" => (658, "middle", 96),
                    _ => ((from + to) / 2, "middle", 96),
                };
                (arrow(from, to, &ink.hex()))
                text x=(middle + if name == "SP" { 16 } else { 0 }) y="42" text-anchor=(anchor) fill=(ink.hex()) { (name) }
                text x=(middle) y=(y) text-anchor=(anchor) font-size="11" fill=(Ink::Soft.hex()) {
                    title { (tag) }
                    (shortened(tag, LETTERS))
                }
            }
            path d="M 722 50 V 130 H 76 V 64" fill="none" stroke=(Ink::Pv.hex()) stroke-width="1.5" {}
            path d="M 71 74 L 76 64 L 81 74 Z" fill=(Ink::Pv.hex()) {}
        }
    };
    Picture::new(WIDTH, HEIGHT, format!("Loop diagram of {}", tags.pv), body.into_string())
}

fn arrow(from: i32, to: i32, colour: &str) -> PreEscaped<String> {
    html! {
        path d=(format!("M {from} 50 H {}", to - 4)) fill="none" stroke=(colour) stroke-width="1.5" {}
        path d=(format!("M {} 45 L {to} 50 L {} 55 Z", to - 10, to - 10)) fill=(colour) {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_from_outside_are_escaped_and_kept_whole_for_the_pointer() {
        let long = format!("<script>alert(1)</script>{}", "X".repeat(200));
        let svg = loop_diagram(&Tags::of_loop(&long, false, true)).svg();
        assert!(!svg.contains("<script") && svg.contains("&lt;script&gt;alert(1)"));
        assert!(svg.contains(&"X".repeat(200)) && svg.contains("not recorded"));
    }
}

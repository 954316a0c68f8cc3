//! All pictures in one SVG file.

use std::fmt::Write;

use maud::html;

use super::Report;
use super::figures::{Figure, Subject, brief, detailed};
use super::ink::{self, Ink};
use super::plot::PlotError;
use stiction::words;

const WIDTH: u32 = 1120;
const GAP: u32 = 20;
/// Height of a loop's heading and of a picture's title.
const HEADING: u32 = 40;
const TITLE: u32 = 22;

/// Draws all loops' pictures below each other, small ones in pairs.
///
/// # Errors
/// [`PlotError`], if a picture cannot be drawn.
pub fn sheet(report: &Report) -> Result<String, PlotError> {
    let (mut body, mut y) = (String::new(), GAP);
    for &k in &report.by_urgency() {
        let one = &report.loops[k];
        let a = &one.document.assessment;
        let subject = Subject {
            record: &one.record,
            original: one.original.as_ref(),
            assessment: a,
            tags: &one.tags,
            detail: one.detail.as_ref(),
        };
        let in_full = report.loops.len() == 1 || one.detail.is_some() || one.full;
        let figures = if in_full { detailed(&subject)? } else { brief(&subject)? };
        let heading = format!("{}: {}", one.document.loop_name, words::headline(a));
        text(&mut body, y + 22, 18, &super::plot::shortened(&heading, 100));
        y += HEADING;
        place(&mut body, &mut y, &figures);
    }
    text(&mut body, y + 16, 12, &super::plot::shortened(&report.command, 150));
    y += HEADING;
    let (style, paper) = (ink::style(), Ink::Paper.hex());
    Ok(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"plot\" width=\"{WIDTH}\" height=\"{y}\" viewBox=\"0 0 {WIDTH} {y}\" \
         font-family=\"system-ui, sans-serif\">\n<style>{style}</style>\n<rect width=\"{WIDTH}\" height=\"{y}\" \
         fill=\"{paper}\"/>\n{body}</svg>\n"
    ))
}

fn place(body: &mut String, y: &mut u32, figures: &[Figure]) {
    let mut left: Option<u32> = None;
    for figure in figures {
        let p = &figure.picture;
        let x = match (figure.wide, left) {
            (false, Some(height)) => {
                write_figure(body, WIDTH / 2 + GAP / 2, *y, figure);
                *y += height.max(p.height) + TITLE + GAP;
                left = None;
                continue;
            }
            (false, None) => {
                left = Some(p.height);
                GAP
            }
            (true, Some(height)) => {
                *y += height + TITLE + GAP;
                left = None;
                GAP
            }
            (true, None) => GAP,
        };
        write_figure(body, x, *y, figure);
        if left.is_none() {
            *y += p.height + TITLE + GAP;
        }
    }
    if let Some(height) = left {
        *y += height + TITLE + GAP;
    }
}

fn write_figure(body: &mut String, x: u32, y: u32, figure: &Figure) {
    let title = html! {
        text x=(x) y=(y + 14) font-size="14" font-weight="600" fill=(Ink::Text.hex()) { (figure.picture.title) }
    };
    let _ = writeln!(body, "{}\n{}", title.into_string(), figure.picture.at(x, y + TITLE));
}

fn text(body: &mut String, y: u32, size: u32, words: &str) {
    let line = html! { text x=(GAP) y=(y) font-size=(size) fill=(Ink::Text.hex()) { (words) } };
    let _ = writeln!(body, "{}", line.into_string());
}

//! Pictures as SVG, from data alone: nothing here depends on valves.
//!
//! [`trend`] stacks panels over one axis, [`scatter`] draws curves and points over a plane; [`super::chart`] has histograms,
//! heat maps and bars. A [`Picture`] is readable without scripts; a page's script finds the axes' scales in `data-axes` and
//! shows the values under the pointer.

use std::collections::BTreeMap;
use std::fmt::Write;

use plotters::chart::ChartContext;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use thiserror::Error;

use super::across::{Across, Ticked, tick};
use super::ink::Ink;

/// Why a picture could not be drawn.
#[derive(Debug, Error)]
#[error("the picture {what:?} cannot be drawn: {why}")]
pub struct PlotError {
    /// Its title.
    pub what: String,
    /// The drawing library's error.
    pub why: String,
}

/// A finished picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Width on a desktop page, CSS pixels.
    pub width: u32,
    /// Height at that width.
    pub height: u32,
    /// Its title, also for readers that cannot see it.
    pub title: String,
    /// Scales of the axes, one group for each panel, in the form read by the page's script; empty for pictures without axes.
    axes: String,
    /// Values over a plane and their names, in the form read by the page's script; empty for other pictures.
    cells: String,
    /// Elements, in units of 1 / [`FINE`] pixel.
    body: String,
}

/// Drawing units in a pixel: the drawing library has integer coordinates only.
pub const FINE: u32 = 2;
/// Size of text, drawing units.
const TEXT: u32 = 13 * FINE;
/// Stroke width that marks dashed lines until [`tidied`]: the library has no dashes that continue around bends.
const DASHED: u32 = 1_001;
/// Mean width of a letter, relative to the text size.
const LETTER: f64 = 0.56;

impl Picture {
    /// A picture from elements in units of 1 / [`FINE`] pixel.
    #[must_use]
    pub const fn new(width: u32, height: u32, title: String, body: String) -> Self {
        Self { width, height, title, axes: String::new(), cells: String::new(), body }
    }

    /// The SVG element, for a page.
    #[must_use]
    pub fn svg(&self) -> String {
        self.element(&format!("width=\"{}\" height=\"{}\"", self.width, self.height))
    }

    /// The SVG element at a position inside another one, pixels.
    #[must_use]
    pub fn at(&self, x: u32, y: u32) -> String {
        self.element(&format!("x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{}\"", self.width, self.height))
    }

    /// Stores values over a plane for the page's script: the names of both axes and of the value, then groups of three numbers.
    pub(super) fn note_cells(&mut self, cells: &[[f64; 3]], names: [&str; 3]) {
        let name = maud::html! { (names.map(|name| name.replace([';', '|'], ",")).join("|")) }.into_string();
        let known = cells.iter().filter(|c| c.iter().all(|v| v.is_finite()));
        let groups: Vec<String> = known.map(|[x, y, z]| format!("{x:.4} {y:.4} {z:.4}")).collect();
        self.cells = format!("{name};{}", groups.join(";"));
    }

    fn element(&self, place: &str) -> String {
        let note = |name: &str, text: &str| if text.is_empty() { String::new() } else { format!(" {name}=\"{text}\"") };
        let (axes, cells) = (note("data-axes", &self.axes), note("data-cells", &self.cells));
        let (w, h) = (self.width * FINE, self.height * FINE);
        let title = maud::html! { (self.title) }.into_string();
        format!(
            "<svg class=\"plot\" {place} viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"{title}\"{axes}{cells}>\n{}</svg>",
            self.body
        )
    }
}

impl maud::Render for Picture {
    fn render_to(&self, buffer: &mut String) {
        buffer.push_str(&self.svg());
    }
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// A line.
    Line,
    /// A thin line, for things behind others.
    Thin,
    /// A dashed line.
    Dashed,
    /// A line that holds each value until the next.
    Steps,
    /// A dot at each point.
    Dots,
    /// The density of points in small squares, where overlapping lines would be a solid blot.
    Density,
    /// A larger ring at each point.
    Rings,
}

/// One series. A value that is not finite interrupts it.
#[derive(Debug, Clone)]
pub struct Series<'a> {
    /// Its name in the legend; empty leaves it out.
    pub name: &'a str,
    /// Positions on the horizontal axis.
    pub x: &'a [f64],
    /// Values, one for each position.
    pub y: &'a [f64],
    /// Colour.
    pub ink: Ink,
    /// How it is drawn.
    pub mark: Mark,
}

/// One panel of a [`trend`].
#[derive(Debug, Clone)]
pub struct Panel<'a> {
    /// Label of its vertical axis, with the unit.
    pub y_label: &'a str,
    /// Series in drawing order.
    pub series: Vec<Series<'a>>,
    /// Height, pixels, without the axis below.
    pub height: u32,
    /// Ranges of the horizontal axis to shade.
    pub shaded: &'a [[f64; 2]],
}

/// Draws panels above each other with a common horizontal axis. Curves are thinned to the extremes of each pixel column.
///
/// # Errors
/// [`PlotError`], if the drawing library fails.
pub fn trend(title: &str, width: u32, across: &Across, panels: &[Panel<'_>]) -> Result<Picture, PlotError> {
    let x = range(panels.iter().flat_map(|p| &p.series).flat_map(|s| s.x.iter().copied()), 0.0);
    let legends: Vec<Vec<Vec<Entry<'_>>>> = panels.iter().map(|p| legend(p.y_label, &p.series, width)).collect();
    let tops: Vec<u32> = legends.iter().map(|rows| LEGEND * rows.len() as u32 + 2).collect();
    let below = |k: usize| if k + 1 == panels.len() { X_LABELS } else { 8 };
    let heights: Vec<u32> = panels.iter().enumerate().map(|(k, p)| tops[k] + p.height + below(k)).collect();
    draw(title, width, heights.iter().sum(), |root, axes| {
        let mut rest = root.clone();
        for (k, panel) in panels.iter().enumerate() {
            let (area, left) = rest.split_vertically(heights[k] * FINE);
            rest = left;
            write_legend(&area, &legends[k])?;
            let y = range(panel.series.iter().flat_map(|s| s.y.iter().copied()), 0.06);
            let last = k + 1 == panels.len();
            let across = if last { across.clone() } else { across.without_labels() };
            let mut chart = frame(&area, tops[k], x, y, &across)?;
            note_axes(axes, &chart);
            for [from, to] in panel.shaded {
                let box_of = [(from.max(x[0]), y[0]), (to.min(x[1]), y[1])];
                chart.draw_series([Rectangle::new(box_of, Ink::Faint.colour().mix(0.6).filled())])?;
            }
            for series in &panel.series {
                curve(&mut chart, series, true)?;
            }
        }
        Ok(())
    })
}

/// A plane with curves and points, not thinned.
#[derive(Debug, Clone)]
pub struct Plane<'a> {
    /// What it shows.
    pub title: &'a str,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Horizontal axis, with the unit.
    pub x_label: &'a str,
    /// Vertical axis, with the unit.
    pub y_label: &'a str,
    /// Series in drawing order.
    pub series: Vec<Series<'a>>,
}

/// Draws curves and points over a plane (phase plots, errors by level).
///
/// # Errors
/// [`PlotError`], if the drawing library fails.
pub fn scatter(plane: &Plane<'_>) -> Result<Picture, PlotError> {
    let x = range(plane.series.iter().flat_map(|s| s.x.iter().copied()), 0.04);
    let y = range(plane.series.iter().flat_map(|s| s.y.iter().copied()), 0.04);
    let [width, height] = plane.size;
    let legend = legend(plane.y_label, &plane.series, width);
    draw(plane.title, width, height, |root, axes| {
        write_legend(root, &legend)?;
        let mut chart = frame(root, LEGEND * legend.len() as u32 + 2, x, y, &Across::value(plane.x_label))?;
        note_axes(axes, &chart);
        for series in &plane.series {
            curve(&mut chart, series, false)?;
        }
        Ok(())
    })
}

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<Ticked, RangedCoordf64>>;
pub(super) type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// Height of a legend's row and of the labels below an axis, and width of the labels beside an axis, pixels.
pub(super) const LEGEND: u32 = 18;
pub(super) const X_LABELS: u32 = 38;
const Y_LABELS: u32 = 50;
const RIGHT: u32 = 14;

/// Runs a drawing and extracts its elements from the library's document.
pub(super) fn draw(
    title: &str,
    width: u32,
    height: u32,
    paint: impl FnOnce(&Area<'_>, &mut String) -> Drawn,
) -> Result<Picture, PlotError> {
    let (mut text, mut axes) = (String::new(), String::new());
    let failed = |why: DrawingAreaErrorKind<std::io::Error>| PlotError { what: title.to_owned(), why: why.to_string() };
    {
        let root = SVGBackend::with_string(&mut text, (width * FINE, height * FINE)).into_drawing_area();
        paint(&root, &mut axes).and_then(|()| root.present()).map_err(failed)?;
    }
    let start = text.find('>').map_or(0, |at| at + 1);
    let end = text.rfind("</svg>").unwrap_or(text.len()).max(start);
    let body = tidied(text[start..end].trim_start());
    Ok(Picture { width, height, title: title.to_owned(), axes, cells: String::new(), body })
}

/// The library's elements with dashes, and more compact: texts on one line, no opacity of 1.
fn tidied(body: &str) -> String {
    let dashes = format!("stroke-width=\"{}\" stroke-dasharray=\"{} {}\"", 2 * FINE, 5 * FINE, 4 * FINE);
    let body = body.replace(&format!("stroke-width=\"{DASHED}\""), &dashes);
    body.replace(" opacity=\"1\"", "")
        .replace(" font-family=\"sans-serif\"", "")
        .replace(">\n", ">")
        .replace("\n</", "</")
}

/// The smallest range that contains all finite values, extended by `margin` of its width on both sides; never empty.
pub(super) fn range(values: impl Iterator<Item = f64>, margin: f64) -> [f64; 2] {
    let [low, high] = values
        .filter(|v| v.is_finite())
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)]);
    if low > high {
        return [0.0, 1.0];
    }
    let least = 1e-9_f64.max(1e-6 * low.abs().max(high.abs()));
    let pad = (margin * (high - low)).max(if high - low < least { least } else { 0.0 });
    [low - pad, high + pad]
}

/// Text style of this size, drawing units.
pub(super) fn written(size: u32, ink: Ink) -> TextStyle<'static> {
    TextStyle { color: ink.colour().to_backend_color(), ..TextStyle::from(("sans-serif", size)) }
}

/// Text style anchored at a corner or side.
pub(super) fn words(ink: Ink, across: HPos, down: VPos) -> TextStyle<'static> {
    written(TEXT, ink).pos(Pos::new(across, down))
}

/// Draws axes, ticks and grid below a legend of `top` pixels. Without `x_label` the horizontal axis has no numbers.
pub(super) fn frame<'a>(
    area: &Area<'a>,
    top: u32,
    x: [f64; 2],
    y: [f64; 2],
    across: &Across,
) -> Result<Chart<'a>, DrawingAreaErrorKind<std::io::Error>> {
    let below = if across.labelled() { X_LABELS } else { 4 };
    let plot_w = area.dim_in_pixel().0.saturating_sub((RIGHT + Y_LABELS) * FINE);
    let ticks = across.ticks(x, plot_w / FINE);
    let mut chart = ChartBuilder::on(area)
        .margin_top(top * FINE)
        .margin_right(RIGHT * FINE)
        .x_label_area_size(below * FINE)
        .y_label_area_size(Y_LABELS * FINE)
        .build_cartesian_2d(Ticked::new(x, ticks), y[0]..y[1])?;
    let tall = y[1] - y[0];
    let (x_text, y_text) = (move |v: &f64| across.tick(*v, x), move |v: &f64| tick(*v, tall));
    let (_, plot_h) = chart.plotting_area().dim_in_pixel();
    chart
        .configure_mesh()
        .y_labels((plot_h / (26 * FINE)).clamp(2, 8) as usize)
        .max_light_lines(0)
        .bold_line_style(Ink::Faint.colour().stroke_width(FINE))
        .axis_style(Ink::Soft.colour().stroke_width(FINE))
        .label_style(written(TEXT - FINE, Ink::Soft))
        .axis_desc_style(written(TEXT - FINE, Ink::Soft))
        .set_all_tick_mark_size(4 * FINE)
        .x_desc(across.title(x))
        .x_label_formatter(&x_text)
        .y_label_formatter(&y_text)
        .draw()?;
    Ok(chart)
}

/// Stores a panel's scales for the page's script: pixels left, right, top, bottom, then the values there.
pub(super) fn note_axes(axes: &mut String, chart: &Chart<'_>) {
    let area = chart.plotting_area();
    let (across, down) = area.get_pixel_range();
    let (x, y) = (area.get_x_range(), area.get_y_range());
    let _ = write!(
        axes,
        "{} {} {} {} {} {} {} {};",
        across.start, across.end, down.start, down.end, x.start, x.end, y.end, y.start
    );
}

/// Draws one series.
pub(super) fn curve(chart: &mut Chart<'_>, series: &Series<'_>, thin: bool) -> Drawn {
    let colour = series.ink.colour();
    let (across, _) = chart.plotting_area().get_pixel_range();
    let x = chart.plotting_area().get_x_range();
    let columns = if thin { ((across.end - across.start) as u32 / FINE).max(1) as usize } else { usize::MAX };
    let width = match series.mark {
        Mark::Thin => FINE,
        Mark::Dashed => DASHED,
        _ => FINE * 8 / 5,
    };
    for run in runs(series) {
        let run = if thin { thinned(&run, [x.start, x.end], columns) } else { run };
        match series.mark {
            Mark::Dots => {
                let dot = |p| Circle::new(p, FINE * 3 / 2, colour.mix(0.55).filled());
                chart.draw_series(run.into_iter().map(dot))?;
            }
            Mark::Density => {
                let (_, down) = chart.plotting_area().get_pixel_range();
                let y = chart.plotting_area().get_y_range();
                let cells =
                    [(across.end - across.start) / SQUARE, (down.end - down.start) / SQUARE].map(|n| n.max(1) as usize);
                let squares = squares(&run, [[x.start, x.end], [y.start, y.end]], cells);
                chart.draw_series(squares.into_iter().map(|(at, share)| {
                    Rectangle::new(at, colour.mix(LEAST_INK + (1.0 - LEAST_INK) * share).filled())
                }))?;
            }
            Mark::Rings => {
                chart.draw_series(run.into_iter().map(|p| Circle::new(p, 4 * FINE, colour.stroke_width(2 * FINE))))?;
            }
            Mark::Steps => {
                let steps = run.windows(2).flat_map(|w| [w[0], (w[1].0, w[0].1)]).chain(run.last().copied());
                chart.draw_series([PathElement::new(steps.collect::<Vec<_>>(), colour.stroke_width(width))])?;
            }
            Mark::Line | Mark::Thin | Mark::Dashed => {
                chart.draw_series([PathElement::new(run, colour.stroke_width(width))])?;
            }
        }
    }
    Ok(())
}

/// Side of a [`Mark::Density`] square, drawing units, and the opacity of one with a single point.
const SQUARE: i32 = 4 * FINE as i32;
const LEAST_INK: f64 = 0.15;

/// The squares of a plane, in a grid of `cells`, that contain points: two corners, and the logarithm of the count relative to
/// that of the fullest square.
fn squares(points: &[(f64, f64)], plane: [[f64; 2]; 2], cells: [usize; 2]) -> Vec<([(f64, f64); 2], f64)> {
    let side = |k: usize| (plane[k][1] - plane[k][0]) / cells[k] as f64;
    let place = |value: f64, k: usize| (((value - plane[k][0]) / side(k)) as usize).min(cells[k] - 1);
    let mut counts: BTreeMap<[usize; 2], u32> = BTreeMap::new();
    for (x, y) in points {
        *counts.entry([place(*x, 0), place(*y, 1)]).or_default() += 1;
    }
    let log = |count: u32| f64::from(count).ln_1p();
    let most = counts.values().copied().max().map_or(1.0, log);
    let corner = |cell: [usize; 2]| {
        let [x, y] = [0, 1].map(|k| plane[k][0] + cell[k] as f64 * side(k));
        (x, y)
    };
    counts.into_iter().map(|(cell, n)| ([corner(cell), corner(cell.map(|i| i + 1))], log(n) / most)).collect()
}

/// Runs of finite values.
fn runs(series: &Series<'_>) -> Vec<Vec<(f64, f64)>> {
    let mut out: Vec<Vec<(f64, f64)>> = Vec::new();
    let mut open = false;
    for (&x, &y) in series.x.iter().zip(series.y) {
        if !(x.is_finite() && y.is_finite()) {
            open = false;
            continue;
        }
        match out.last_mut().filter(|_| open) {
            Some(run) => run.push((x, y)),
            None => out.push(vec![(x, y)]),
        }
        open = true;
    }
    out
}

/// At most four points for each of `columns` columns of the range: first, minimum, maximum and last, in order. The visible
/// shape is preserved, since extremes are kept, not averaged.
#[must_use]
pub fn thinned(points: &[(f64, f64)], x: [f64; 2], columns: usize) -> Vec<(f64, f64)> {
    if points.len() <= columns.saturating_mul(4) || x[1] <= x[0] {
        return points.to_vec();
    }
    let column = |p: &(f64, f64)| ((p.0 - x[0]) / (x[1] - x[0]) * columns as f64).floor();
    let mut out = Vec::with_capacity(4 * columns);
    for group in points.chunk_by(|a, b| column(a) == column(b)) {
        let place = |best: fn(f64, f64) -> bool| {
            (1..group.len()).fold(0, |at, k| if best(group[k].1, group[at].1) { k } else { at })
        };
        let mut kept = [0, place(|a, b| a < b), place(|a, b| a > b), group.len() - 1];
        kept.sort_unstable();
        let mut last = usize::MAX;
        for k in kept {
            if k != last {
                out.push(group[k]);
            }
            last = k;
        }
    }
    out
}

/// An entry of a legend; the first one names the axis.
pub(super) struct Entry<'a> {
    text: std::borrow::Cow<'a, str>,
    /// Position of its left end, pixels.
    x: f64,
    mark: Option<(Ink, Mark)>,
}

/// A text of at most `letters`, with its middle cut out if necessary.
#[must_use]
pub fn shortened(text: &str, letters: usize) -> std::borrow::Cow<'_, str> {
    let count = text.chars().count();
    if count <= letters {
        return text.into();
    }
    let keep = letters.saturating_sub(1);
    let head: String = text.chars().take(keep - keep / 2).collect();
    let tail: String = text.chars().skip(count - keep / 2).collect();
    format!("{head}\u{2026}{tail}").into()
}

/// Estimated width of a text, pixels, from the mean width of a letter.
#[must_use]
pub fn text_width(text: &str) -> f64 {
    text.chars().count() as f64 * LETTER * f64::from(TEXT / FINE)
}

/// Rows of a legend: the axis' name, then every named series.
pub(super) fn legend<'a>(y_label: &'a str, series: &[Series<'a>], width: u32) -> Vec<Vec<Entry<'a>>> {
    const SWATCH: f64 = 22.0;
    const AIR: f64 = 14.0;
    let most = ((f64::from(width) - 60.0) / (LETTER * f64::from(TEXT / FINE))) as usize;
    let mut rows = vec![vec![Entry { text: shortened(y_label, most), x: 6.0, mark: None }]];
    let mut x = 6.0 + text_width(&rows[0][0].text) + 1.5 * AIR;
    for s in series.iter().filter(|s| !s.name.is_empty()) {
        let text = shortened(s.name, most);
        let wide = SWATCH + text_width(&text);
        if x + wide > f64::from(width - RIGHT / 2) {
            rows.push(Vec::new());
            x = 16.0;
        }
        if let Some(row) = rows.last_mut() {
            row.push(Entry { text, x, mark: Some((s.ink, s.mark)) });
        }
        x += wide + AIR;
    }
    rows
}

pub(super) fn write_legend(area: &Area<'_>, rows: &[Vec<Entry<'_>>]) -> Drawn {
    let fine = f64::from(FINE);
    for (k, row) in rows.iter().enumerate() {
        let y = (k as f64 + 0.5) * f64::from(LEGEND) * fine;
        for entry in row {
            let x = entry.x * fine;
            let Some((ink, mark)) = entry.mark else {
                let style = words(Ink::Text, HPos::Left, VPos::Center);
                area.draw(&Text::new(entry.text.clone().into_owned(), (x as i32, y as i32), style))?;
                continue;
            };
            let (from, to) = ((x as i32, y as i32), ((x + 17.0 * fine) as i32, y as i32));
            let colour = ink.colour();
            match mark {
                Mark::Dots => area.draw(&Circle::new((from.0 + 8 * FINE as i32, from.1), 3 * FINE, colour.filled()))?,
                Mark::Rings => {
                    let ring = colour.stroke_width(2 * FINE);
                    area.draw(&Circle::new((from.0 + 8 * FINE as i32, from.1), 4 * FINE, ring))?;
                }
                Mark::Dashed => area.draw(&PathElement::new(vec![from, to], colour.stroke_width(DASHED)))?,
                _ => area.draw(&PathElement::new(vec![from, to], colour.stroke_width(2 * FINE)))?,
            }
            let style = words(Ink::Text, HPos::Left, VPos::Center);
            let place = ((x + 22.0 * fine) as i32, y as i32);
            area.draw(&Text::new(entry.text.clone().into_owned(), place, style))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_extremes_and_order() {
        let points: Vec<(f64, f64)> =
            (0..10_000).map(|k| (f64::from(k), if k == 5_003 { 9.0 } else { f64::from(k % 7) })).collect();
        let thin = thinned(&points, [0.0, 10_000.0], 200);
        assert!(thin.len() <= 800 && thin.contains(&(5_003.0, 9.0)));
        assert!(thin.windows(2).all(|w| w[0].0 < w[1].0));
        assert_eq!((thin.first(), thin.last()), (points.first(), points.last()));
        assert_eq!(thinned(&points[..50], [0.0, 50.0], 200).len(), 50);
    }

    #[test]
    fn ranges_are_never_empty() {
        for values in [vec![], vec![3.0], vec![0.0, 0.0], vec![1e12, 1e12], vec![f64::NAN, 2.0], vec![-1e-20, 1e-20]] {
            let [low, high] = range(values.iter().copied(), 0.1);
            assert!(low < high && low.is_finite() && high.is_finite(), "{values:?}");
        }
    }

    #[test]
    fn names_from_outside_cannot_leave_their_text() {
        let y = [1.0, f64::NAN, 3.0, 2.0];
        let x = [0.0, 1.0, 2.0, 3.0];
        let evil = "<script>alert('x')</script>\"&";
        let series = vec![Series { name: evil, x: &x, y: &y, ink: Ink::Pv, mark: Mark::Line }];
        let panels = [Panel { y_label: evil, series, height: 100, shaded: &[[1.0, 2.0]] }];
        let svg = trend(evil, 520, &Across::value(evil), &panels).unwrap().svg();
        assert!(!svg.contains("<script") && svg.contains("&lt;script"), "{svg}");
        assert!(svg.matches("<polyline").count() > 3 && !svg.contains("NaN"));
        assert!(!svg.contains("http"));
    }

    #[test]
    fn squares_hold_every_point_once_and_the_fullest_is_darkest() {
        let points = [(0.1, 0.1), (0.2, 0.15), (0.15, 0.2), (1.0, 1.0)];
        let found = squares(&points, [[0.0, 1.0], [0.0, 1.0]], [2, 2]);
        assert_eq!(found.len(), 2);
        assert_eq!(found[0], ([(0.0, 0.0), (0.5, 0.5)], 1.0));
        assert_eq!(found[1].0, [(0.5, 0.5), (1.0, 1.0)]);
        assert!((found[1].1 - 0.5).abs() < 1e-12);
    }

    #[test]
    fn long_names_are_cut_in_the_middle_and_wrap() {
        assert_eq!(shortened("abcdefghij", 5), "ab\u{2026}ij");
        assert_eq!(shortened("abc", 5), "abc");
        let long = "x".repeat(300);
        let series: Vec<Series<'_>> =
            (0..3).map(|_| Series { name: &long, x: &[], y: &[], ink: Ink::Op, mark: Mark::Line }).collect();
        let rows = legend("y", &series, 400);
        // The first one still fits next to the axis' name.
        assert_eq!(rows.iter().map(Vec::len).collect::<Vec<_>>(), [2, 1, 1]);
        let end = |e: &Entry<'_>| e.x + text_width(&e.text) + if e.mark.is_some() { 22.0 } else { 0.0 };
        assert!(rows.iter().flatten().all(|e| end(e) <= 400.0));
    }

    #[test]
    fn every_picture_can_be_drawn_without_data() {
        let panels = [Panel { y_label: "y", series: Vec::new(), height: 60, shaded: &[] }];
        assert!(trend("t", 300, &Across::value("x"), &panels).is_ok());
        assert!(trend("t", 300, &Across::value("x"), &[]).is_ok());
        let plane = Plane { title: "p", size: [300, 200], x_label: "x", y_label: "y", series: Vec::new() };
        assert!(scatter(&plane).is_ok());
    }
}

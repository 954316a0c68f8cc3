//! Histograms, heat maps and bars as SVG, like [`super::plot`].

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::across::{Across, tick, ticks};
use super::ink::Ink;
use super::plot::{
    Area, Drawn, FINE, LEGEND, Mark, Picture, PlotError, Series, curve, draw, frame, legend, note_axes, range,
    shortened, text_width, words, write_legend,
};
use stiction::core::units::number;

/// Counts of values along one axis.
#[derive(Debug, Clone)]
pub struct Histogram<'a> {
    /// What it shows.
    pub title: &'a str,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Horizontal axis, with the unit.
    pub x_label: &'a str,
    /// Sets of values: name, values, colour; drawn on top of each other, half transparent.
    pub sets: &'a [(&'a str, &'a [f64], Ink)],
    /// A value to mark, with its name.
    pub mark: Option<(&'a str, f64)>,
}

/// Bins of a histogram.
const BINS: usize = 24;

/// Draws a histogram of one or several sets of values.
///
/// # Errors
/// [`PlotError`], if the drawing library fails.
pub fn histogram(h: &Histogram<'_>) -> Result<Picture, PlotError> {
    let marked = h.mark.map(|m| m.1);
    // At least a few per cent of the marked value wide, since smaller differences do not matter.
    let least = marked.map(|m| [0.97 * m, 1.03 * m]);
    let x = range(h.sets.iter().flat_map(|s| s.1.iter().copied()).chain(least.into_iter().flatten()), 0.05);
    let counted: Vec<Vec<u32>> = h.sets.iter().map(|s| counts(s.1, x, BINS)).collect();
    let most = counted.iter().flatten().copied().max().unwrap_or(0).max(1);
    let line = h.mark.map(|(name, at)| (name, [at, at], [0.0, f64::from(most) * 1.08]));
    let mut entries: Vec<Series<'_>> =
        h.sets.iter().map(|s| Series { name: s.0, x: &[], y: &[], ink: s.2, mark: Mark::Dots }).collect();
    entries.extend(line.iter().map(|l| Series { name: l.0, x: &l.1, y: &l.2, ink: Ink::Text, mark: Mark::Dashed }));
    let rows = legend("count", &entries, h.size[0]);
    draw(h.title, h.size[0], h.size[1], |root, axes| {
        write_legend(root, &rows)?;
        let y = [0.0, f64::from(most) * 1.08];
        let mut chart = frame(root, LEGEND * rows.len() as u32 + 2, x, y, &Across::value(h.x_label))?;
        note_axes(axes, &chart);
        let step = (x[1] - x[0]) / BINS as f64;
        for (set, counts) in h.sets.iter().zip(&counted) {
            let bars = counts.iter().enumerate().filter(|(_, n)| **n > 0).map(|(k, n)| {
                let left = x[0] + k as f64 * step;
                let place = [(left, 0.0), (left + step, f64::from(*n))];
                Rectangle::new(place, set.2.colour().mix(0.6).filled())
            });
            chart.draw_series(bars)?;
        }
        entries.iter().try_for_each(|e| curve(&mut chart, e, false))
    })
}

/// Number of values in each of `bins` equal parts of a range; values at its end belong to the last part.
#[must_use]
pub fn counts(values: &[f64], x: [f64; 2], bins: usize) -> Vec<u32> {
    let mut out = vec![0; bins];
    for v in values.iter().filter(|v| (x[0]..=x[1]).contains(*v)) {
        let bin = ((v - x[0]) / (x[1] - x[0]) * bins as f64) as usize;
        out[bin.min(bins - 1)] += 1;
    }
    out
}

/// A line over a [`HeatMap`], or a word if it has a single point.
#[derive(Debug, Clone)]
pub struct Overlay<'a> {
    /// Its name in the legend; empty leaves it out.
    pub name: &'a str,
    /// Vertices.
    pub points: Vec<(f64, f64)>,
    /// How it is drawn; [`Mark::Dots`] for a single best point.
    pub mark: Mark,
    /// Colour.
    pub ink: Ink,
}

/// Colours over a plane of two values.
#[derive(Debug, Clone)]
pub struct HeatMap<'a> {
    /// What it shows.
    pub title: &'a str,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Horizontal axis, with the unit.
    pub x_label: &'a str,
    /// Vertical axis, with the unit.
    pub y_label: &'a str,
    /// Quantity shown by the colours, with the unit.
    pub z_label: &'a str,
    /// Cells: centre on either axis, and value. Values that are not finite are left out.
    pub cells: &'a [[f64; 3]],
    /// Width and height of a cell.
    pub step: [f64; 2],
    /// Range of the horizontal axis.
    pub x: [f64; 2],
    /// Range of the vertical axis.
    pub y: [f64; 2],
    /// Vertices of the meaningful part of the plane; it is grey where there is no value.
    pub ground: Vec<(f64, f64)>,
    /// Lines and points over it.
    pub overlays: Vec<Overlay<'a>>,
    /// Words over it: position and text.
    pub words: Vec<([f64; 2], &'a str)>,
}

/// Width of the colour scale including its numbers, pixels.
const SCALE: u32 = 100;

/// Draws a heat map with its colour scale.
///
/// # Errors
/// [`PlotError`], if the drawing library fails.
pub fn heat_map(map: &HeatMap<'_>) -> Result<Picture, PlotError> {
    let z = Scale::of(range(map.cells.iter().map(|c| c[2]), 0.0));
    let [width, height] = map.size;
    let entries: Vec<Series<'_>> =
        map.overlays.iter().map(|o| Series { name: o.name, x: &[], y: &[], ink: shown(o.ink), mark: o.mark }).collect();
    let rows = legend(map.y_label, &entries, width);
    let top = LEGEND * rows.len() as u32 + 2;
    let mut picture = draw(map.title, width, height, |root, axes| {
        write_legend(root, &rows)?;
        let (left, right) = root.split_horizontally((width - SCALE) * FINE);
        let mut chart = frame(&left, top, map.x, map.y, &Across::value(map.x_label))?;
        note_axes(axes, &chart);
        chart.draw_series([Polygon::new(map.ground.clone(), RGBColor(0x80, 0x86, 0x90).filled())])?;
        let [half_x, half_y] = map.step.map(|s| 0.5 * s);
        let cells = map.cells.iter().filter(|c| c[2].is_finite()).map(|[x, y, v]| {
            let corners = [
                ((x - half_x).max(map.x[0]), (y + half_y).min(map.y[1])),
                ((x + half_x).min(map.x[1]), (y - half_y).max(map.y[0])),
            ];
            Rectangle::new(corners, z.colour(*v).filled())
        });
        chart.draw_series(cells)?;
        for overlay in &map.overlays {
            let (x, y): (Vec<f64>, Vec<f64>) = overlay.points.iter().copied().unzip();
            curve(&mut chart, &Series { name: "", x: &x, y: &y, ink: overlay.ink, mark: overlay.mark }, false)?;
        }
        for (place, text) in &map.words {
            let style = words(Ink::Over, HPos::Center, VPos::Center);
            chart.draw_series([Text::new((*text).to_owned(), (place[0], place[1]), style)])?;
        }
        scale(&right, top, height, z, map.z_label)
    })?;
    picture.note_cells(map.cells, [map.x_label, map.y_label, map.z_label]);
    Ok(picture)
}

/// Lines over colours are white; the legend on the page background shows them in text colour.
fn shown(ink: Ink) -> Ink {
    if ink == Ink::Over { Ink::Soft } else { ink }
}

/// A scale of colours over a range of values.
#[derive(Debug, Clone, Copy)]
struct Scale {
    z: [f64; 2],
    /// Whether the scale is logarithmic.
    log: bool,
}

impl Scale {
    fn of(z: [f64; 2]) -> Self {
        Self { z, log: z[0] > 0.0 && z[1] > 3.0 * z[0] }
    }

    /// Value at a fraction of the scale.
    fn at(self, share: f64) -> f64 {
        let [low, high] = self.z;
        if self.log { low * (high / low).powf(share) } else { low + (high - low) * share }
    }

    fn share(self, value: f64) -> f64 {
        let [low, high] = self.z;
        let share = if self.log { (value / low).ln() / (high / low).ln() } else { (value - low) / (high - low) };
        share.clamp(0.0, 1.0)
    }

    /// Dark for small values, bright for large ones; perceptually uniform, also for colour-blind readers.
    fn colour(self, value: f64) -> RGBColor {
        ViridisRGB.get_color(self.share(value) as f32)
    }
}

fn scale(area: &Area<'_>, top: u32, height: u32, z: Scale, label: &str) -> Drawn {
    const PARTS: u32 = 40;
    let fine = FINE as i32;
    let (from, to) = ((top * FINE) as i32, ((height - super::plot::X_LABELS) * FINE) as i32);
    let at = |k: u32| to - (to - from) * k as i32 / PARTS as i32;
    for k in 0..PARTS {
        let value = z.at((f64::from(k) + 0.5) / f64::from(PARTS));
        area.draw(&Rectangle::new([(2 * fine, at(k + 1)), (14 * fine, at(k))], z.colour(value).filled()))?;
    }
    for k in (0..=PARTS).step_by(8) {
        let value = z.at(f64::from(k) / f64::from(PARTS));
        let style = words(Ink::Soft, HPos::Left, VPos::Center);
        area.draw(&Text::new(number(value), (18 * fine, at(k).max(from + 5 * fine)), style))?;
    }
    let style = words(Ink::Soft, HPos::Left, VPos::Center);
    let room = ((f64::from(SCALE) - 2.0) / text_width("x")) as usize;
    area.draw(&Text::new(shortened(label, room).into_owned(), (0, to + 14 * fine), style))
}

/// One horizontal bar.
#[derive(Debug, Clone, PartialEq)]
pub struct Bar<'a> {
    /// Its name.
    pub label: &'a str,
    /// Its length; `None` is shown as unknown.
    pub value: Option<f64>,
    /// Its interval.
    pub interval: Option<[f64; 2]>,
    /// Colour.
    pub ink: Ink,
    /// A note after it; if empty, the value.
    pub note: &'a str,
}

/// Draws horizontal bars with intervals, in the given order.
///
/// # Errors
/// [`PlotError`], if the drawing library fails.
pub fn bars(title: &str, width: u32, x_label: &str, rows: &[Bar<'_>]) -> Result<Picture, PlotError> {
    const ROW: u32 = 26;
    let fine = f64::from(FINE);
    let widest = rows.iter().map(|r| text_width(r.label)).fold(40.0, f64::max).min(0.36 * f64::from(width));
    let letters = (widest / text_width("x")).floor() as usize + 1;
    let left = widest + 18.0;
    let noted: Vec<String> =
        rows.iter().map(|r| if r.note.is_empty() { value_text(r.value) } else { r.note.to_owned() }).collect();
    let behind = noted.iter().map(|n| text_width(n)).fold(20.0, f64::max).min(0.3 * f64::from(width));
    let right = f64::from(width) - behind - 14.0;
    let ends = rows.iter().flat_map(|r| r.value.into_iter().chain(r.interval.into_iter().flatten()));
    let mut x = range(ends.chain([0.0]), 0.03);
    if rows.iter().all(|r| r.value.is_none_or(|v| v >= 0.0) && r.interval.is_none_or(|i| i[0] >= 0.0)) {
        x[0] = 0.0;
    }
    let at = |v: f64| ((left + (v - x[0]) / (x[1] - x[0]) * (right - left)) * fine) as i32;
    let height = ROW * rows.len() as u32 + 40;
    let bottom = (ROW * rows.len() as u32 + 4) as i32 * FINE as i32;
    draw(title, width, height, |root, _| {
        for v in ticks(x, 5) {
            let grid = Ink::Faint.colour().stroke_width(FINE);
            root.draw(&PathElement::new([(at(v), 0), (at(v), bottom)], grid))?;
            let style = words(Ink::Soft, HPos::Center, VPos::Top);
            root.draw(&Text::new(tick(v, x[1] - x[0]), (at(v), bottom + 2 * FINE as i32), style))?;
        }
        root.draw(&PathElement::new([(at(0.0), 0), (at(0.0), bottom)], Ink::Soft.colour().stroke_width(FINE)))?;
        let style = words(Ink::Soft, HPos::Center, VPos::Top);
        let middle = (at(x[0]) + at(x[1])) / 2;
        root.draw(&Text::new(x_label.to_owned(), (middle, bottom + 18 * FINE as i32), style))?;
        for (k, row) in rows.iter().enumerate() {
            let y = |part: f64| ((k as f64 + part) * f64::from(ROW) * fine) as i32;
            let style = words(Ink::Text, HPos::Right, VPos::Center);
            let place = (((left - 8.0) * fine) as i32, y(0.5));
            root.draw(&Text::new(shortened(row.label, letters).into_owned(), place, style))?;
            if let Some(v) = row.value {
                let (from, to) = (at(v.min(0.0)), at(v.max(0.0)));
                root.draw(&Rectangle::new([(from, y(0.2)), (to, y(0.8))], row.ink.colour().mix(0.75).filled()))?;
            }
            if let Some([low, high]) = row.interval {
                let line = Ink::Text.colour().stroke_width(3 * FINE / 2);
                root.draw(&PathElement::new([(at(low), y(0.5)), (at(high), y(0.5))], line))?;
                for end in [low, high] {
                    root.draw(&PathElement::new([(at(end), y(0.3)), (at(end), y(0.7))], line))?;
                }
            }
            let style = words(Ink::Text, HPos::Left, VPos::Center);
            let room = (behind / text_width("x")).floor() as usize + 1;
            let note = shortened(&noted[k], room).into_owned();
            root.draw(&Text::new(note, (((right + 8.0) * fine) as i32, y(0.5)), style))?;
        }
        Ok(())
    })
}

fn value_text(value: Option<f64>) -> String {
    value.map_or_else(|| "unknown".to_owned(), number)
}

/// Draws a table of fractions as colours with numbers, row by row, for example truths by answers. Counts are integers.
///
/// # Errors
/// [`PlotError`], if the drawing library fails.
pub fn confusion(
    title: &str,
    width: u32,
    rows: &[&str],
    columns: &[&str],
    counts: &[Vec<u32>],
) -> Result<Picture, PlotError> {
    const ROW: u32 = 24;
    let fine = FINE as i32;
    let widest = rows.iter().map(|r| text_width(r)).fold(40.0, f64::max).min(0.4 * f64::from(width));
    let letters = (widest / text_width("x")).floor() as usize + 1;
    let left = widest as i32 + 14;
    let head = columns.iter().map(|c| text_width(&shortened(c, letters))).fold(20.0, f64::max) as i32 + 12;
    let cell = (width as i32 - left - 6) / columns.len().max(1) as i32;
    let height = head as u32 + ROW * rows.len() as u32 + 6;
    draw(title, width, height, |root, _| {
        for (k, name) in columns.iter().enumerate() {
            let style = words(Ink::Text, HPos::Left, VPos::Center).transform(FontTransform::Rotate270);
            let place = ((left + cell * k as i32 + cell / 2) * fine, (head - 6) * fine);
            root.draw(&Text::new(shortened(name, letters).into_owned(), place, style))?;
        }
        for (r, name) in rows.iter().enumerate() {
            let y = head + ROW as i32 * r as i32;
            let style = words(Ink::Text, HPos::Right, VPos::Center);
            let place = ((left - 8) * fine, (y + ROW as i32 / 2) * fine);
            root.draw(&Text::new(shortened(name, letters).into_owned(), place, style))?;
            let total: u32 = counts.get(r).map_or(0, |c| c.iter().sum());
            for (k, n) in counts.get(r).into_iter().flatten().enumerate() {
                let share = f64::from(*n) / f64::from(total.max(1));
                let x = left + cell * k as i32;
                let corners = [(x * fine, y * fine), ((x + cell - 1) * fine, (y + ROW as i32 - 1) * fine)];
                root.draw(&Rectangle::new(corners, Scale::of([0.0, 1.0]).colour(share).filled()))?;
                let (red, green, blue) = Scale::of([0.0, 1.0]).colour(share).rgb();
                let bright = u32::from(red) * 3 + u32::from(green) * 6 + u32::from(blue) > 1500;
                let ink = if bright { RGBColor(0, 0, 0) } else { RGBColor(255, 255, 255) };
                let place = ((x + cell / 2) * fine, (y + ROW as i32 / 2) * fine);
                let style = words(Ink::Text, HPos::Center, VPos::Center).color(&ink);
                root.draw(&Text::new(n.to_string(), place, style))?;
            }
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_counted_once() {
        let values: Vec<f64> = (0..=100).map(|k| f64::from(k) / 100.0).collect();
        let n = counts(&values, [0.0, 1.0], 10);
        assert_eq!(n.iter().sum::<u32>(), 101);
        assert_eq!((n[0], n[9]), (10, 11));
        assert_eq!(counts(&[f64::NAN, 2.0], [0.0, 1.0], 4), vec![0; 4]);
    }

    #[test]
    fn maps_bars_and_tables_escape_what_they_show() {
        let evil = "<img src=x onerror=alert(1)>";
        let overlays = vec![Overlay { name: evil, points: vec![(0.1, 0.1)], mark: Mark::Rings, ink: Ink::Over }];
        let map = HeatMap {
            title: evil,
            size: [520, 360],
            x_label: evil,
            y_label: "fd",
            z_label: evil,
            cells: &[[0.1, 0.1, 1.0], [0.3, 0.1, f64::NAN], [0.5, 0.1, 3.0]],
            step: [0.2, 0.2],
            x: [0.0, 1.0],
            y: [0.0, 0.5],
            ground: vec![(0.0, 0.0), (0.5, 0.5), (1.0, 0.0)],
            overlays,
            words: vec![([0.5, 0.2], evil)],
        };
        let picture = heat_map(&map).unwrap().svg();
        let bar = Bar { label: evil, value: None, interval: Some([-1.0, 2.0]), ink: Ink::Op, note: evil };
        let bars = bars(evil, 500, evil, &[bar]).unwrap().svg();
        let table = confusion(evil, 500, &[evil, "b"], &["a", evil], &[vec![3, 1], vec![0, 0]]).unwrap().svg();
        let h = Histogram {
            title: evil,
            size: [400, 200],
            x_label: evil,
            sets: &[(evil, &[1.0, 2.0], Ink::Op)],
            mark: Some((evil, 1.5)),
        };
        for svg in [picture, bars, table, histogram(&h).unwrap().svg()] {
            assert!(!svg.contains("<img") && svg.contains("&lt;img"), "{svg}");
            assert!(!svg.contains("NaN") && svg.starts_with("<svg "), "{svg}");
        }
    }
}

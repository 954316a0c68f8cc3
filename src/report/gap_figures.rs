//! Pictures of a gap: simulation and measured PV before and after the cause is added, and the residual by time, cycle,
//! frequency and level.

use super::across::Across;
use super::chart::{Bar, bars};
use super::figures::Figure;
use super::ink::Ink;
use super::plot::{Mark, Panel, Plane, PlotError, Series, scatter, trend};
use stiction::core::gap::document::EffectNote;
use stiction::core::signal::stats;
use stiction::core::units::number;
use stiction::words::gap_text;
use stiction_engine::analysis::gap::Diagnosed;

const WIDE: u32 = 1080;
const HALF: u32 = 520;
/// Most dots in a scatter plot.
const MAX_DOTS: usize = 700;
/// Bins for the line through a scatter plot.
const BINS: usize = 12;
/// Most effects drawn.
const MAX_EFFECTS: usize = 10;
/// Limits of the axis of the gap closed, %.
const CLOSED: [f64; 2] = [-100.0, 100.0];

type Made = Result<Figure, PlotError>;

/// Data of the pictures, point by point.
struct Points<'a> {
    of: &'a Diagnosed,
    time_s: Vec<f64>,
    /// Residuals of base and cause; NaN where they are not scored.
    before: Vec<f64>,
    after: Vec<f64>,
    /// Held-out stretches, s.
    held_out: Vec<[f64; 2]>,
    /// Indices of held-out points with a residual.
    tested: Vec<usize>,
    /// Whether a cause was added.
    added: bool,
}

impl<'a> Points<'a> {
    fn of(of: &'a Diagnosed) -> Self {
        let (record, predictions) = (&of.record, &of.diagnosis.predictions);
        let left = |simulated: &[Option<f64>]| -> Vec<f64> {
            let pairs = record.pv.iter().zip(simulated);
            pairs.map(|(pv, p)| p.map_or(f64::NAN, |p| pv - p)).collect()
        };
        let before = left(&predictions.pv_base);
        let held = |k: &usize| {
            of.diagnosis.findings.blocks.held_out.get(*k).copied().unwrap_or(false) && before[*k].is_finite()
        };
        let tested: Vec<usize> = (0..before.len()).filter(held).collect();
        let ts = record.point_s();
        let mut stretches: Vec<[f64; 2]> = Vec::new();
        for &k in &tested {
            let t = k as f64 * ts;
            match stretches.last_mut() {
                Some(last) if t - last[1] <= 1.5 * ts => last[1] = t,
                _ => stretches.push([t, t]),
            }
        }
        Self {
            time_s: (0..record.len()).map(|k| k as f64 * ts).collect(),
            after: left(&predictions.pv_after),
            added: predictions.pv_after != predictions.pv_base,
            held_out: stretches,
            tested,
            before,
            of,
        }
    }

    /// Values at the tested points, thinned for a scatter plot.
    fn cloud(&self, x: &dyn Fn(usize) -> f64, y: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let step = self.tested.len().div_ceil(MAX_DOTS).max(1);
        self.tested.iter().step_by(step).map(|&k| (x(k), y[k])).unzip()
    }

    /// Means of the tested points in equal bins of x: bin centres and means.
    fn means(&self, x: &dyn Fn(usize) -> f64, y: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let places: Vec<f64> = self.tested.iter().map(|&k| x(k)).filter(|v| v.is_finite()).collect();
        let sorted = stats::sorted(&places);
        let (Some(low), Some(high)) = (sorted.first(), sorted.last()) else { return (Vec::new(), Vec::new()) };
        let width = (high - low) / BINS as f64;
        let bin = |i: usize| {
            let (from, to) = (low + i as f64 * width, low + (i + 1) as f64 * width);
            let last = i + 1 == BINS;
            let inside = self.tested.iter().filter(|k| (from..to).contains(&x(**k)) || (last && x(**k) == to));
            let values: Vec<f64> = inside.map(|&k| y[k]).filter(|v| v.is_finite()).collect();
            (values.len() > 2).then(|| (0.5 * (from + to), stats::mean(&values)))
        };
        if width > 0.0 { (0..BINS).filter_map(bin).unzip() } else { (Vec::new(), Vec::new()) }
    }
}

/// Draws all pictures of one loop.
///
/// # Errors
/// [`PlotError`], if the drawing library fails.
pub fn figures(of: &Diagnosed) -> Result<Vec<Figure>, PlotError> {
    let p = Points::of(of);
    let mut out = vec![runs(&p)?, residuals(&p)?];
    out.extend(ranked(of)?);
    out.extend(made_of(of)?);
    out.push(phases(of)?);
    out.push(since_slip(&p)?);
    out.push(frequency(of)?);
    out.push(level(&p)?);
    Ok(out)
}

fn runs(p: &Points<'_>) -> Made {
    let (record, predictions) = (&p.of.record, &p.of.diagnosis.predictions);
    let plain = |x: &[Option<f64>]| x.iter().map(|v| v.unwrap_or(f64::NAN)).collect::<Vec<_>>();
    let (base, after) = (plain(&predictions.pv_base), plain(&predictions.pv_after));
    let line = |name, y, ink, mark| Series { name, x: &p.time_s, y, ink, mark };
    let mut series = vec![line("measured", &record.pv, Ink::Pv, Mark::Line)];
    series.push(line("base", &base, Ink::Other, Mark::Thin));
    if p.added {
        series.push(line("with the cause", &after, Ink::Fit, Mark::Line));
    }
    let op = record.op();
    let valve = &p.of.diagnosis.findings.base.valve;
    let below = vec![line("OP", &op, Ink::Op, Mark::Line), line("base's valve", valve, Ink::Mv, Mark::Steps)];
    if let Some(sp) = &record.sp {
        series.insert(0, line("SP", sp, Ink::Sp, Mark::Steps));
    }
    let panels = [
        Panel { y_label: "PV", series, height: 250, shaded: &p.held_out },
        Panel { y_label: "OP", series: below, height: 130, shaded: &p.held_out },
    ];
    let picture = trend("Measured against simulated", WIDE, &Across::value("time, s"), &panels)?;
    let caption =
        "Free runs from OP as recorded. No model was fitted to the shaded stretches: the gap is measured there.";
    Ok(Figure { picture, caption: caption.to_owned(), wide: true })
}

fn residuals(p: &Points<'_>) -> Made {
    let line = |name, y, ink| Series { name, x: &p.time_s, y, ink, mark: Mark::Line };
    let mut series = vec![line("base", &p.before, Ink::Error)];
    if p.added {
        series.push(line("with the cause", &p.after, Ink::Fit));
    }
    let panels = [Panel { y_label: "PV less simulation", series, height: 170, shaded: &p.held_out }];
    let picture = trend("What the simulation leaves, over time", WIDE, &Across::value("time, s"), &panels)?;
    let l = &p.of.document.location;
    let caption = match (l.onset_s, l.trend.onset_ratio) {
        (Some(at), Some(ratio)) => {
            format!("Its power changes {} s after the start, {}-fold.", number(at), number(ratio))
        }
        _ => "Its power does not change.".to_owned(),
    };
    Ok(Figure { picture, caption, wide: true })
}

fn percent_note(share: Option<f64>, expected: Option<f64>) -> String {
    match (share, expected) {
        (Some(s), Some(e)) => format!("{:.0} % ({:.0} % of time)", 100.0 * s, 100.0 * e),
        (Some(s), None) => format!("{:.0} %", 100.0 * s),
        _ => "never".to_owned(),
    }
}

fn phases(of: &Diagnosed) -> Made {
    let l = &of.document.location;
    let (s, e) = (l.phases, l.phases_expected);
    let window = format!("{} s after a slip", number(l.slip_window_s));
    let rows: [(&str, Option<f64>, Option<f64>); 5] = [
        ("at rest", s.stuck, e.stuck),
        (&window, s.slip, e.slip),
        ("moving", s.moving, e.moving),
        ("after a move up", l.direction.up, None),
        ("after a move down", l.direction.down, None),
    ];
    let notes: Vec<String> = rows.iter().map(|(_, s, e)| percent_note(*s, *e)).collect();
    let list: Vec<Bar<'_>> = rows
        .iter()
        .zip(&notes)
        .map(|((label, share, _), note)| Bar {
            label,
            value: share.map(|v| 100.0 * v),
            interval: None,
            ink: Ink::Error,
            note,
        })
        .collect();
    let picture = bars("What is left, by what the stem did last", HALF, "% of the squared error", &list)?;
    let test = l.uneven.phases.map_or(String::new(), |t| format!(" Chance gives as uneven phases with p {:.3}.", t.p));
    Ok(Figure { picture, caption: format!("The base's error on held-out stretches.{test}"), wide: false })
}

fn since_slip(p: &Points<'_>) -> Made {
    let slips = &p.of.diagnosis.findings.base.slips;
    let ts = p.of.record.point_s();
    let since = |k: usize| {
        let behind = slips.partition_point(|s| s.point <= k);
        behind.checked_sub(1).map_or(f64::NAN, |i| (k - slips[i].point) as f64 * ts)
    };
    // Multiplied by the sign of the slip, so that the residuals after every slip add up.
    let turned = |y: &[f64]| -> Vec<f64> {
        let sign = |k: usize| {
            let behind = slips.partition_point(|s| s.point <= k);
            behind.checked_sub(1).map_or(1.0, |i| slips[i].direction)
        };
        y.iter().enumerate().map(|(k, v)| v * sign(k)).collect()
    };
    let (before, after) = (turned(&p.before), turned(&p.after));
    cloud(
        p,
        "What is left, by time since the last slip",
        ["s since the stem's last move", "PV less simulation, along the move"],
        &since,
        [&before, &after],
    )
}

fn level(p: &Points<'_>) -> Made {
    let op = p.of.record.op();
    let x = |k: usize| op[k];
    let mut figure = cloud(p, "What is left, by level", ["OP", "PV less simulation"], &x, [&p.before, &p.after])?;
    if let Some(r2) = p.of.document.location.level_r2.op {
        figure.caption =
            format!("{} The level explains {:.0} % of the base's (p {:.3}).", figure.caption, 100.0 * r2.value, r2.p);
    }
    Ok(figure)
}

fn cloud(p: &Points<'_>, title: &str, labels: [&str; 2], x: &dyn Fn(usize) -> f64, y: [&[f64]; 2]) -> Made {
    let (dots_x, dots_y) = p.cloud(x, y[0]);
    let (mean_x, mean_y) = p.means(x, y[0]);
    let (after_x, after_y) = p.means(x, y[1]);
    let mut series = vec![
        Series { name: "base", x: &dots_x, y: &dots_y, ink: Ink::Other, mark: Mark::Dots },
        Series { name: "its mean", x: &mean_x, y: &mean_y, ink: Ink::Error, mark: Mark::Line },
    ];
    if p.added {
        let name = "mean with the cause";
        series.push(Series { name, x: &after_x, y: &after_y, ink: Ink::Fit, mark: Mark::Line });
    }
    let plane = Plane { title, size: [HALF, 320], x_label: labels[0], y_label: labels[1], series };
    let caption = "Held-out points; the lines are means over twelfths of the axis.".to_owned();
    Ok(Figure { picture: scatter(&plane)?, caption, wide: false })
}

fn frequency(of: &Diagnosed) -> Made {
    let l = &of.document.location;
    let names = ["below 0.3", "0.3 to 0.7", "0.7 to 1.3", "1.3 to 2.5", "2.5 to 6", "6 to 15", "above 15"];
    let notes: Vec<String> = l
        .bands
        .iter()
        .map(|b| match b.share {
            Some(s) => format!("{:.0} %", 100.0 * s),
            None => "not sampled".to_owned(),
        })
        .collect();
    let list: Vec<Bar<'_>> = l
        .bands
        .iter()
        .zip(names)
        .zip(&notes)
        .map(|((b, label), note)| Bar {
            label,
            value: b.share.map(|s| 100.0 * s),
            interval: None,
            ink: Ink::Error,
            note,
        })
        .collect();
    let picture = bars("What is left, by frequency", HALF, "% of the squared error", &list)?;
    let caption = format!(
        "The base's error on held-out stretches, by multiples of the oscillation's frequency ({} Hz).",
        number(l.fundamental_hz)
    );
    Ok(Figure { picture, caption, wide: false })
}

/// Shares of PV's variance, one bar each.
fn made_of(of: &Diagnosed) -> Result<Option<Figure>, PlotError> {
    let Some(budget) = gap_text::budget(&of.document) else { return Ok(None) };
    let notes: Vec<String> = budget.parts.iter().map(|part| format!("{:.1} %", part.share_pct)).collect();
    let list: Vec<Bar<'_>> = budget
        .parts
        .iter()
        .zip(&notes)
        .map(|(part, note)| Bar { label: &part.words, value: Some(part.share_pct), interval: None, ink: Ink::Pv, note })
        .collect();
    let picture = bars("What PV is made of", WIDE, "% of PV's variance", &list)?;
    let caption = "Parts under a model of the noise; together 100 %. A part below 0 works against the others.";
    Ok(Some(Figure { picture, caption: caption.to_owned(), wide: true }))
}

fn ranked(of: &Diagnosed) -> Result<Option<Figure>, PlotError> {
    let d = &of.document;
    let drawn: Vec<&EffectNote> =
        d.effects.iter().chain(&d.pairs).filter(|e| e.closed_pct.is_some()).take(MAX_EFFECTS).collect();
    if drawn.is_empty() {
        return Ok(None);
    }
    // Adding zero turns -0 into 0.
    let rounded = |x: f64, digits: f64| (x * digits).round() / digits + 0.0;
    let note = |e: &&EffectNote| {
        let closed = rounded(e.closed_pct.unwrap_or(0.0), 1.0);
        format!("{closed:.0} %, evidence {:+.2}", rounded(e.evidence, 100.0))
    };
    let notes: Vec<String> = drawn.iter().map(note).collect();
    let inside = |v: f64| v.clamp(CLOSED[0], CLOSED[1]);
    let list: Vec<Bar<'_>> = drawn
        .iter()
        .zip(&notes)
        .map(|(e, note)| Bar {
            label: &e.id,
            value: e.closed_pct.map(inside),
            interval: e.closed_interval.map(|i| i.map(inside)),
            ink: if e.id == d.cause.id || d.second_cause.as_ref().is_some_and(|s| s.id == e.id) {
                Ink::Fit
            } else {
                Ink::Other
            },
            note,
        })
        .collect();
    let picture = bars("How far each effect closes the gap", WIDE, "% of the gap closed, with 90 % interval", &list)?;
    let caption = format!(
        "On held-out stretches, ranked by evidence on the others. The answer: {}. Bars end at -100 %.",
        gap_text::answer(d)
    );
    Ok(Some(Figure { picture, caption, wide: true }))
}

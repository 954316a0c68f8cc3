//! One loop's pictures, from its record and the results computed from it.

use stiction::core::ident::region::{BOUNDS, STRENGTHS};
use stiction::core::ident::{OrderBy, OrderChoice};
use stiction::core::record::Record;
use stiction::core::signal::{lag, stats};
use stiction::core::verdict::Assessment;
use stiction::toolbox::fit_plots::{ErrorMap, Optimum};

use super::across::Across;
use super::chart::{Bar, HeatMap, Histogram, Overlay, bars, heat_map, histogram};
use super::detail::Detail;
use super::diagram::{Tags, loop_diagram};
use super::ink::Ink;
use super::plot::{Mark, Panel, Picture, Plane, PlotError, Series, scatter, trend};
use stiction::core::units::number;

/// A picture with its caption.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// The picture.
    pub picture: Picture,
    /// What it shows and how to read it.
    pub caption: String,
    /// Whether it needs the whole width of the page.
    pub wide: bool,
}

/// The data for a loop's pictures.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// The record that was analysed.
    pub record: &'a Record,
    /// The section as recorded, if the analysed one was downsampled.
    pub original: Option<&'a Record>,
    /// Its assessment.
    pub assessment: &'a Assessment,
    /// Names of its signals.
    pub tags: &'a Tags,
    /// Results for the detailed pictures.
    pub detail: Option<&'a Detail>,
}

const WIDE: u32 = 1080;
const HALF: u32 = 520;
/// Points of a curve in an overview picture.
const FEW_POINTS: usize = 160;
/// Points above which a phase plot shows their density.
const DENSE: usize = 2_500;

type Figures = Result<Vec<Figure>, PlotError>;

fn times(record: &Record) -> Vec<f64> {
    (0..record.len()).map(|k| k as f64 * record.point_s()).collect()
}

/// All detailed pictures; without a fit, those that need one are left out.
///
/// # Errors
/// [`PlotError`], if the drawing library fails.
pub fn detailed(of: &Subject<'_>) -> Figures {
    let recorded = of.original.unwrap_or(of.record);
    let caption = format!("The loop and its tags. Sampling time {} s.", number(recorded.recorded_ts_s));
    let mut out = vec![Figure { picture: loop_diagram(of.tags), caption, wide: true }];
    if let Some(original) = of.original {
        let caption = format!("As recorded: {} samples of {} s.", original.raw_samples, number(original.ts_s));
        out.push(Figure {
            picture: trends("Trends before downsampling", original, of.tags, WIDE)?,
            caption,
            wide: true,
        });
    }
    let boxed = match of.record.box_samples {
        1 => String::new(),
        k => format!(" Each point averages {k} samples: PV's mean, the middle of OP's extremes."),
    };
    let after = if of.original.is_some() { "After downsampling, as analysed: " } else { "As analysed: " };
    let caption = format!("{after}{} points, one every {} s.{boxed}", of.record.len(), number(of.record.point_s()));
    out.push(Figure { picture: trends("Trends", of.record, of.tags, WIDE)?, caption, wide: true });
    if let Some(detail) = of.detail {
        out.push(fit(of, detail)?);
    }
    if let Some(original) = of.original {
        let picture = phase("Phase plot before downsampling", of, original, 0, None)?;
        out.push(Figure { picture, caption: "PV over OP before downsampling.".to_owned(), wide: false });
    }
    out.extend(phases(of)?);
    if let Some(detail) = of.detail {
        out.push(orders(of, detail)?);
        for map in &detail.maps {
            out.push(error_map(of, detail, map)?);
        }
        out.extend(draws(of, detail)?);
    }
    if of.assessment.indicators.iter().any(|w| w.contribution != 0.0) {
        out.push(indicators(of.assessment)?);
    }
    Ok(out)
}

/// The two pictures of a loop that is shown briefly.
///
/// # Errors
/// [`PlotError`], if the drawing library fails.
pub fn brief(of: &Subject<'_>) -> Figures {
    let step = of.record.len().div_ceil(FEW_POINTS).max(1);
    let short = thinner(of.record, step);
    let caption = format!("{} points, drawn from every {step}.", of.record.len());
    let caption = if step == 1 { format!("{} points.", of.record.len()) } else { caption };
    Ok(vec![
        Figure { picture: trends("Trends", &short, of.tags, HALF)?, caption, wide: false },
        Figure { picture: phase("Phase plot", of, &short, 0, None)?, caption: "PV over OP.".to_owned(), wide: false },
    ])
}

/// Every `step`-th point of a record, only for small pictures.
fn thinner(record: &Record, step: usize) -> Record {
    let every = |x: &[f64]| x.iter().copied().step_by(step).collect::<Vec<_>>();
    Record {
        op_path: every(&record.op()),
        pv: every(&record.pv),
        sp: record.sp.as_deref().map(every),
        mv: record.mv.as_deref().map(every),
        ts_s: record.point_s() * step as f64,
        box_samples: 1,
        ..record.clone()
    }
}

fn line<'a>(name: &'a str, x: &'a [f64], y: &'a [f64], ink: Ink, mark: Mark) -> Series<'a> {
    Series { name, x, y, ink, mark }
}

/// PV with SP above OP with MV.
fn trends(title: &str, record: &Record, tags: &Tags, width: u32) -> Result<Picture, PlotError> {
    let (t, op) = (times(record), record.op());
    let [op_unit, pv_unit] = &tags.units;
    let mut above = Vec::new();
    if let Some(sp) = &record.sp {
        above.push(line("SP", &t, sp, Ink::Sp, Mark::Steps));
    }
    above.push(line("PV", &t, &record.pv, Ink::Pv, Mark::Line));
    let mut panels = vec![
        Panel { y_label: pv_unit, series: above, height: 150, shaded: &[] },
        Panel { y_label: op_unit, series: vec![line("OP", &t, &op, Ink::Op, Mark::Line)], height: 130, shaded: &[] },
    ];
    if let Some(mv) = &record.mv {
        let series = vec![line("MV", &t, mv, Ink::Mv, Mark::Line)];
        panels.push(Panel { y_label: "MV units", series, height: 110, shaded: &[] });
    }
    trend(title, width, &Across::time_from(record.start_ns), &panels)
}

fn fit(of: &Subject<'_>, detail: &Detail) -> Result<Figure, PlotError> {
    let (t, op, run) = (times(of.record), of.record.op(), &detail.run);
    let [op_unit, pv_unit] = &of.tags.units;
    let late = &t[run.from.min(t.len())..];
    let panels = [
        Panel {
            y_label: pv_unit,
            series: vec![
                line("PV measured", &t, &of.record.pv, Ink::Pv, Mark::Line),
                line("PV by the model, free run", late, &run.pv, Ink::Fit, Mark::Line),
            ],
            height: 150,
            shaded: &[],
        },
        Panel {
            y_label: op_unit,
            series: vec![
                line("OP", &t, &op, Ink::Op, Mark::Line),
                line("valve by the model", &t, &run.valve, Ink::Mv, Mark::Line),
            ],
            height: 130,
            shaded: &[],
        },
        Panel {
            y_label: pv_unit,
            series: vec![line("residual: measured less model", late, &run.residual, Ink::Error, Mark::Line)],
            height: 90,
            shaded: &[],
        },
    ];
    let picture = trend("Measured and fitted", WIDE, &Across::time_from(of.record.start_ns), &panels)?;
    let explained = of.assessment.process.as_ref().map_or(0.0, |p| p.fit_pct);
    let caption = format!(
        "A free run: valve law and process respond to OP alone. Fit {explained:.1} % (100 is perfect, 0 no better than \
         PV's mean). The residual shows what the model leaves out."
    );
    Ok(Figure { picture, caption, wide: true })
}

fn phase(
    title: &str,
    of: &Subject<'_>,
    record: &Record,
    shift: usize,
    valve: Option<&[f64]>,
) -> Result<Picture, PlotError> {
    let op = record.op();
    let n = record.len();
    let x = valve.unwrap_or(&op);
    let (x, y) = (&x[..n - shift.min(n)], &record.pv[shift.min(n)..]);
    let [op_unit, pv_unit] = &of.tags.units;
    let (label, ink) = match valve {
        Some(_) => (format!("valve by the model, {op_unit}"), Ink::Mv),
        None => (op_unit.clone(), Ink::Op),
    };
    // Many overlapping cycles would be a solid blot.
    let mark = if n > DENSE { Mark::Density } else { Mark::Thin };
    let series = vec![line("", x, y, ink, mark)];
    scatter(&Plane { title, size: [HALF, 340], x_label: &label, y_label: pv_unit, series })
}

fn phases(of: &Subject<'_>) -> Figures {
    let record = of.record;
    let most = of.assessment.oscillation.period_s.map_or(record.len() / 8, |p| (0.5 * p / record.point_s()) as usize);
    let shift = lag::of_largest_correlation(&record.op(), &record.pv, most.min(record.len() / 3));
    let mut out = vec![
        Figure {
            picture: phase("Phase plot", of, record, 0, None)?,
            caption:
                "PV over OP as recorded. Lag and dead time open it whether or not the valve sticks: with a lag that is \
                      short against the period, a sticking valve shows stretches in which OP moves and PV does not."
                    .to_owned(),
            wide: false,
        },
        Figure {
            picture: phase("Phase plot, shifted", of, record, shift, None)?,
            caption: format!(
                "PV {} s later over OP: the shift with the best correlation, so that dead time and lag alone do not \
                 open the loop.",
                number(shift as f64 * record.point_s())
            ),
            wide: false,
        },
    ];
    if let Some(detail) = of.detail {
        let picture = phase("Phase plot of the fitted valve", of, record, shift, Some(&detail.run.valve))?;
        let caption =
            "PV, shifted as before, over the valve position of the fit: the remaining opening is the process lag.";
        out.push(Figure { picture, caption: caption.to_owned(), wide: false });
    }
    Ok(out)
}

/// fs and fd for a pair (s, j).
fn bands(s: f64, j: f64) -> (f64, f64) {
    (0.5 * (s + j), 0.5 * (s - j))
}

fn error_map(of: &Subject<'_>, detail: &Detail, map: &ErrorMap) -> Result<Figure, PlotError> {
    let a = of.assessment;
    let deviation = stats::std_dev(&of.record.pv);
    let cells: Vec<[f64; 3]> =
        map.cells.iter().filter_map(|c| c.rms.map(|rms| [c.fs, c.fd, 100.0 * rms / deviation])).collect();
    let span = detail.span;
    let over = |points: Vec<(f64, f64)>, mark| Overlay { name: "", points, mark, ink: Ink::Over };
    let mut overlays = vec![
        // The triangle's right side, fs + fd = S0, and its upper side, fs = fd.
        over(vec![(0.0, 0.0), (0.5 * span, 0.5 * span), (span, 0.0)], Mark::Thin),
        over(vec![bands(BOUNDS[0] * span, 0.0), bands(BOUNDS[0] * span, BOUNDS[0] * span)], Mark::Dashed),
    ];
    for share in [BOUNDS[1], BOUNDS[2]] {
        overlays.push(over(
            vec![bands(BOUNDS[0] * span, share * BOUNDS[0] * span), bands(span, share * span)],
            Mark::Dashed,
        ));
    }
    for share in STRENGTHS {
        overlays.push(over(vec![bands(share * span, 0.0), bands(share * span, share * span)], Mark::Dashed));
    }
    let [fs, fd] = Detail::suggested(map);
    let corners = vec![(fs[0], fd[0]), (fs[1], fd[0]), (fs[1], fd[1]), (fs[0], fd[1]), (fs[0], fd[0])];
    overlays.push(Overlay { name: "suggested", points: corners, mark: Mark::Line, ink: Ink::Over });
    let chosen = a.process.as_ref().is_some_and(|p| p.order == map.order);
    if let (true, Some([s0, s1]), Some([j0, j1])) = (chosen, a.s_interval, a.j_interval) {
        let ring = [(s0, j0), (s1, j0), (s1, j1), (s0, j1), (s0, j0)];
        let points = ring.map(|(s, j)| bands(s.min(span), j.clamp(0.0, s.min(span)))).to_vec();
        overlays.push(Overlay { name: "90 % interval", points, mark: Mark::Line, ink: Ink::Op });
    }
    if let (true, Some(fs), Some(fd)) = (chosen, a.fs, a.fd) {
        overlays.push(Overlay { name: "answer", points: vec![(fs, fd)], mark: Mark::Rings, ink: Ink::Op });
    }
    let least = vec![(map.best.fs, map.best.fd)];
    overlays.push(Overlay { name: "least", points: least, mark: Mark::Dots, ink: Ink::Error });
    let [op_unit, _] = &of.tags.units;
    let picture = heat_map(&HeatMap {
        title: &format!("Error map, {}, order {}", map.law.words(), map.order),
        size: [HALF, 400],
        x_label: &format!("fs, {op_unit}"),
        y_label: &format!("fd, {op_unit}"),
        z_label: "rms, % of std",
        cells: &cells,
        step: [map.step; 2],
        x: [0.0, span * 1.02],
        y: [0.0, 0.54 * span],
        ground: vec![(0.0, 0.0), (0.5 * span, 0.5 * span), (span, 0.0)],
        overlays,
        words: [
            ([0.052, 0.013], "none"),
            ([0.43, 0.385], "deadband"),
            ([0.52, 0.27], "deadband with stick and slip"),
            ([0.79, 0.028], "stick-slip"),
            ([0.135, 0.058], "weak"),
            ([0.33, 0.12], "moderate"),
            ([0.72, 0.13], "strong"),
        ]
        .map(|(place, word)| (place.map(|v| v * span), word))
        .to_vec(),
    })?;
    let mark = if chosen { " This estimate has this law and order." } else { "" };
    let rho = a.fitted_by.map_or(0.0, |basis| basis.error_filter);
    let filtered = if rho > 0.0 {
        format!(", behind the filter 1 - {} q^-1 that makes the residual white, as it was minimised", number(rho))
    } else {
        String::new()
    };
    let caption = format!(
        "Free-run error over the bands, {}, order {}{filtered}: each cell with its best process. Below the line fs + fd = S0 = {}. \
         Least cell: fs {}, fd {}. Box, the suggested region: fs {} to {}, fd {} to {}. It holds the cells within a \
         tenth of the way from the least squared error to that without friction, and the answer's. Grey: the stem moves too seldom for a \
         model.{mark}",
        map.law.words(),
        map.order,
        number(span),
        number(map.best.fs),
        number(map.best.fd),
        number(fs[0]),
        number(fs[1]),
        number(fd[0]),
        number(fd[1]),
    );
    Ok(Figure { picture, caption, wide: false })
}

fn draws(of: &Subject<'_>, detail: &Detail) -> Figures {
    let a = of.assessment;
    let column = |all: &[Optimum], f: fn(&Optimum) -> f64| all.iter().map(f).collect::<Vec<f64>>();
    let mut out = Vec::new();
    for (name, value, get) in
        [("fs", a.fs, (|o| o.fs) as fn(&Optimum) -> f64), ("fd", a.fd, (|o| o.fd) as fn(&Optimum) -> f64)]
    {
        let (again, drawn) = (column(&detail.restarts, get), column(&detail.bootstrap, get));
        let names = [format!("{} restarts", again.len()), format!("{} resamples", drawn.len())];
        let picture = histogram(&Histogram {
            title: &format!("Histogram of {name}"),
            size: [HALF, 240],
            x_label: &format!("{name}, {}", of.tags.units[0]),
            sets: &[(&names[1], &drawn, Ink::Pv), (&names[0], &again, Ink::Op)],
            mark: value.map(|v| ("answer", v)),
        })?;
        let caption = format!(
            "Blue, resamples: {name} refitted with noise and disturbance drawn anew, {}. The narrower they are, the more certain is {name}. Orange, \
             restarts: {name} where searches with other seeds end, {}. Bars far apart mean several possible answers. The \
             90 % interval accounts for more and may be wider.",
            extremes(&drawn),
            extremes(&again),
        );
        out.push(Figure { picture, caption, wide: false });
    }
    Ok(out)
}

/// Smallest and largest of some values, in words.
fn extremes(values: &[f64]) -> String {
    match (values.iter().copied().reduce(f64::min), values.iter().copied().reduce(f64::max)) {
        (Some(least), Some(most)) => format!("{} to {}", number(least), number(most)),
        _ => "none".to_owned(),
    }
}

fn orders(of: &Subject<'_>, detail: &Detail) -> Result<Figure, PlotError> {
    let chart = &detail.orders;
    let choice = of.assessment.fitted_by.map(|basis| basis.order);
    let chosen = of.assessment.process.as_ref().map_or(0, |p| p.order);
    let mut rows = Vec::new();
    for (at, f) in chart.figures.iter().enumerate() {
        // The errors that decided, not others of the same kind.
        let held_out = match choice {
            Some(choice) if choice.by != OrderBy::Asked => choice.held_out_rms.and_then(|both| both.get(at).copied()),
            _ => Some(f.held_out_rms),
        };
        rows.push((format!("order {}, fitted", f.order), f.fitted_rms, Ink::Other));
        rows.extend(held_out.map(|rms| (format!("order {}, held out", f.order), rms, Ink::Fit)));
    }
    let bar = |(label, value, ink): &(String, f64, Ink)| {
        (label.clone(), Bar { label: "", value: Some(*value), interval: None, ink: *ink, note: "" })
    };
    let rows: Vec<(String, Bar<'_>)> = rows.iter().map(bar).collect();
    let rows: Vec<Bar<'_>> = rows.iter().map(|(label, bar)| Bar { label, ..*bar }).collect();
    let picture = bars("Decision chart of the order", HALF, &format!("rms error, {}", of.tags.units[1]), &rows)?;
    let held_out = format!(
        "on its last {:.0} % with the process fitted to the first {:.0} %",
        100.0 * (1.0 - chart.fitted_share),
        100.0 * chart.fitted_share
    );
    let why = match choice {
        Some(OrderChoice { by: OrderBy::HeldOut, held_out_rms: Some([one, two]), rho }) => {
            let removed = 100.0 * (1.0 - (two / one) * (two / one));
            let word = if removed < 0.0 { "adds" } else { "removes" };
            let filter = if rho > 0.0 { " behind the filter that makes the residual white" } else { "" };
            format!(
                "Errors on the whole record, and{filter} {held_out}. The second order is kept where it removes {:.0} % of the \
                 held-out squared error: it {word} {} %.",
                100.0 * chart.must_remove,
                number(removed.abs())
            )
        }
        Some(OrderChoice { by: OrderBy::Asked, .. }) => {
            format!("Errors on the whole record, and {held_out}. The order was asked for.")
        }
        _ if chosen == 1 => "Errors on the whole record. The search found no slips for which a second lag promised to \
                             remove enough of the error, so the orders were not compared on held-out data."
            .to_owned(),
        _ => "Errors on the whole record. The first order could not be fitted to these slips.".to_owned(),
    };
    let caption = format!("{why} This estimate has order {chosen}.");
    Ok(Figure { picture, caption, wide: false })
}

fn indicators(a: &Assessment) -> Result<Figure, PlotError> {
    let base =
        a.explanation.map(|e| Bar { label: "base", value: Some(e.base), interval: None, ink: Ink::Sp, note: "" });
    let said = a.indicators.iter().map(|w| Bar {
        label: w.name,
        value: w.score.map(|_| w.contribution),
        interval: None,
        ink: if w.contribution > 0.0 { Ink::Error } else { Ink::Fit },
        note: "",
    });
    let sum = a.explanation.map(|e| Bar {
        label: "together",
        value: Some(e.logit),
        interval: None,
        ink: Ink::Text,
        note: "",
    });
    let rows: Vec<Bar<'_>> = base.into_iter().chain(said).chain(sum).collect();
    let picture = bars("Indicators", HALF, "log-odds: right points to sticking, left away from it", &rows)?;
    let caption =
        "What each indicator adds; the sum is the log-odds of the calibrated probability (docs/dev/method.md).";
    Ok(Figure { picture, caption: caption.to_owned(), wide: false })
}

//! A recording of one loop over twenty periods, and the same loop in five windows of four periods, each at its own level.

use super::generator::{Case, Order, case};
use super::kinds::Kind;
use crate::truth::draw::Draw;
use stiction::core::record::Record;

/// Windows, and periods in each.
pub const WINDOWS: usize = 5;
/// See [`WINDOWS`].
pub const PERIODS: usize = 4;
/// Largest change of a window's level, standard deviations of PV.
const LEVEL: f64 = 1.0;

/// The loop in both forms.
#[derive(Debug, Clone)]
pub struct InWindows {
    /// The effect, or `none`.
    pub effect: String,
    /// All periods at one level.
    pub whole: Record,
    /// The windows.
    pub windows: Vec<Record>,
}

/// The loop of a seed with one effect of the catalogue (none for `None`); sizes and set-point moves alternate with `index`.
#[must_use]
pub fn in_windows(seed: u64, kind: Option<Kind>, index: usize) -> InWindows {
    let name = kind.map_or("none", Kind::id);
    let stream = format!("windows/{name}/{index}");
    let order = Order {
        stream: stream.clone(),
        seed,
        kinds: kind.into_iter().collect(),
        size: 1 + index % 2,
        setpoint_moves: (index / 2).is_multiple_of(2),
        transient: false,
        mv: false,
        periods: Some((WINDOWS * PERIODS) as f64),
    };
    let Case { op, pv, sp, pv_sd, ts_s, .. } = case(&order);
    let mut draw = Draw::new(seed, &format!("{stream}/levels"));
    let whole = Record { sp: Some(sp), ..Record::uniform(ts_s, op, pv) };
    let length = whole.len() / WINDOWS;
    let window = |at: usize| {
        let mut part = whole.part(at * length, (at + 1) * length);
        let level = LEVEL * pv_sd * draw.between(-1.0, 1.0);
        let signals = [Some(&mut part.pv), part.sp.as_mut()];
        signals.into_iter().flatten().for_each(|x| x.iter_mut().for_each(|y| *y += level));
        part
    };
    let windows = (0..WINDOWS).map(window).collect();
    InWindows { effect: name.to_owned(), whole, windows }
}

//! Loops that act on each other: they are stepped together in every scan, through lags and dead times between them.

use crate::challenge::plant::{Loop, Plant};

/// Signal that an edge carries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Origin {
    /// PV of a loop, relative to its operating point.
    Pv(usize),
    /// Flow through a loop's valve, relative to its operating point.
    Flow(usize),
    /// An external load.
    Outside(usize),
}

/// Where an edge enters a loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Entry {
    /// The process input, OP units.
    Input,
    /// PV itself.
    Pv,
}

/// One connection through which a loop is disturbed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Edge {
    pub from: Origin,
    pub to: usize,
    pub into: Entry,
    pub gain: f64,
    /// First-order lag, scans.
    pub lag: f64,
    /// Dead time, scans.
    pub dead_time: usize,
}

/// Inputs of one loop besides its neighbours, one value per scan.
#[derive(Debug, Clone, Default)]
pub(super) struct Own {
    /// Set point relative to the operating point, PV units.
    pub sp: f64,
    /// At the process input, OP units.
    pub load: Vec<f64>,
    /// On PV as measured, PV units.
    pub noise: Vec<f64>,
}

/// OP and PV of each loop, for as many scans as the inputs have.
pub(super) fn run(plants: &[Plant], own: &[Own], edges: &[Edge], outside: &[Vec<f64>]) -> Vec<[Vec<f64>; 2]> {
    let scans = own.first().map_or(0, |own| own.load.len());
    let mut loops: Vec<Loop> = plants.iter().zip(own).map(|(plant, own)| Loop::new(plant, scans, own.sp)).collect();
    let mut carried = vec![0.0; edges.len()];
    let mut past: Vec<[Vec<f64>; 2]> = vec![Default::default(); plants.len()];
    for k in 0..scans {
        let mut pushes = vec![[0.0; 2]; plants.len()];
        for (edge, carried) in edges.iter().zip(&mut carried) {
            let value = match (k.checked_sub(1 + edge.dead_time), edge.from) {
                (None, _) => 0.0,
                (Some(then), Origin::Pv(from)) => past[from][0][then],
                (Some(then), Origin::Flow(from)) => past[from][1][then],
                (Some(then), Origin::Outside(which)) => outside[which][then],
            };
            *carried += (1.0 - libm::exp(-1.0 / edge.lag.max(0.3))) * (value - *carried);
            pushes[edge.to][usize::from(edge.into == Entry::Pv)] += edge.gain * *carried;
        }
        for (place, now) in loops.iter_mut().enumerate() {
            let [load, on_pv] = pushes[place];
            let own = &own[place];
            now.scan(k, [own.sp, own.load[k] + load, on_pv, own.noise[k]], None);
            past[place][0].push(now.deviation() + on_pv);
            past[place][1].push(now.flow());
        }
    }
    loops.into_iter().map(Loop::into_op_and_pv).collect()
}

//! One effect has one size wherever it is said, the valve's own cycle is nobody else's, and the variance of a cycle is booked
//! to the friction that makes it.
//!
//! Effects are sized twice, by the free run and by the budget's noise model, each blind to something. What both found in one
//! place is one effect: it has the free run's size, and is confirmed only where both agree.

use super::budget::document::{BudgetNote, DISTURBANCE, NOT_SPLIT, PartNote, UPSETS, VALVE_AND_PROCESS};
use super::budget::halves::MOST_RATIO;
use super::document::EffectNote;
use super::effects::{sinusoid, static_nonlinearity, step_load, stiction};
use super::set_point::{self, Move};
use super::types::LITTLE_PCT;

/// Difference of periods, as a share, up to which a wave is the valve's own cycle, and two waves are one.
const SAME_PERIOD: f64 = 0.15;
/// How far apart two instants are that are one, a share of the record, beside the time in which PV answers.
const SAME_TIME: f64 = 0.02;
/// Largest change of a gain with each OP unit, as a share of it, that a plant may have.
pub(super) const MOST_CHANGE_PER_OP: f64 = 1.0;

/// Whether a gain that changes so with each OP unit is one that a plant may have.
#[must_use]
pub(super) fn is_physical(id: &str, parameter: &str, value: f64) -> bool {
    id != static_nonlinearity::EFFECT.id || parameter != "gain_change_per_op" || value.abs() <= MOST_CHANGE_PER_OP
}

/// What the budget is held against.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known<'a> {
    /// The effects of the free run.
    pub effects: &'a [EffectNote],
    /// Period of the valve's limit cycle, s, where it sticks.
    pub cycle_s: Option<f64>,
    /// Share of PV's variance that goes with the friction, where the cycle ends without it.
    pub of_friction: Option<f64>,
    /// Duration of the record and of PV's answer to a step, s.
    pub record_s: f64,
    pub answer_s: f64,
    /// Moves of the set point, and the record's time between points, s.
    pub sp_moves: &'a [Move],
    pub point_s: f64,
}

impl Known<'_> {
    /// Whether an effect of the free run is the valve's own cycle.
    pub(super) fn is_own_cycle(&self, e: &EffectNote) -> bool {
        e.id == sinusoid::EFFECT.id && e.parameters.get("period").is_some_and(|q| self.is_own(q.value))
    }

    /// Whether it is a load that begins while PV answers a move of the set point.
    pub(super) fn follows_set_point(&self, e: &EffectNote) -> bool {
        let value = |name: &str| e.parameters.get(name).map(|q| q.value);
        let place = value("at").zip(value("size")).filter(|_| e.id == step_load::EFFECT.id);
        let answer = 3.0 * self.answer_s / self.point_s;
        place.is_some_and(|(at, size)| set_point::explains(self.sp_moves, (at / self.point_s, size), answer))
    }

    /// The budget's parts without contradictions.
    pub(super) fn settle(&self, budget: &mut BudgetNote) {
        budget.parts.iter_mut().for_each(|part| self.resize(part));
        self.fold_own_cycle(&mut budget.parts);
        self.book_friction(&mut budget.parts);
    }

    /// An effect that the free run has in the same place takes its sizes.
    fn resize(&self, part: &mut PartNote) {
        let id = if part.id == UPSETS { step_load::EFFECT.id } else { &part.id };
        let counts = |e: &&EffectNote| e.id == id && e.closed_pct.is_some_and(|closed| closed >= LITTLE_PCT);
        if let Some(effect) = self.effects.iter().find(counts) {
            let of_effect = |name: &str| effect.parameters.get(name).map(|q| q.value);
            if part.id == UPSETS {
                let (Some(at), Some(size)) = (of_effect("at"), of_effect("size")) else { return };
                let same = |e: &&mut super::budget::document::EventNote| self.is_same_time(e.at_s, at);
                if let Some(event) = part.events.iter_mut().find(same) {
                    event.confirmed &= agree(event.size, size);
                    (event.at_s, event.size, event.length_s) = (at, size, None);
                }
                let confirmed = part.events.iter().filter(|e| e.confirmed).count() >= 2;
                part.confirmed = part.confirmed.map(|was| was && confirmed);
            } else if self.is_same_place(part, effect) {
                let shared = |name: &String| effect.parameters.contains_key(name);
                let sizes = part.parameters.iter().filter(|(name, q)| shared(name) && is_size(name, &q.unit));
                let agrees = sizes.clone().all(|(name, q)| of_effect(name).is_some_and(|own| agree(own, q.value)));
                part.confirmed = part.confirmed.map(|was| was && agrees);
                part.parameters.clone_from(&effect.parameters);
            }
        }
        let physical = part.parameters.iter().all(|(name, q)| is_physical(&part.id, name, q.value));
        part.confirmed = part.confirmed.map(|was| was && physical);
    }

    fn is_same_time(&self, x: f64, y: f64) -> bool {
        (x - y).abs() <= self.answer_s.max(SAME_TIME * self.record_s)
    }

    /// Whether a part is the effect: what passes at the same time, what repeats with the same period.
    fn is_same_place(&self, part: &PartNote, effect: &EffectNote) -> bool {
        let both = |name: &str| Some((part.parameters.get(name)?.value, effect.parameters.get(name)?.value));
        let same_time = ["at", "from"].iter().filter_map(|name| both(name)).all(|(x, y)| self.is_same_time(x, y));
        let same_period = both("period").is_none_or(|(x, y)| (x / y - 1.0).abs() < SAME_PERIOD);
        // A load that goes away again is not one that stays.
        same_time && same_period && !part.parameters.contains_key("length")
    }

    /// Whether a wave of this period is the valve's own cycle.
    fn is_own(&self, period_s: f64) -> bool {
        self.cycle_s.is_some_and(|own| (period_s / own - 1.0).abs() < SAME_PERIOD)
    }

    /// A wave of the limit cycle's period is what the model of valve and process leaves of that cycle.
    fn fold_own_cycle(&self, parts: &mut Vec<PartNote>) {
        let is_own = |p: &PartNote| {
            p.id == sinusoid::EFFECT.id && p.parameters.get("period").is_some_and(|q| self.is_own(q.value))
        };
        let (own, mut kept): (Vec<PartNote>, Vec<PartNote>) = parts.drain(..).partition(is_own);
        for wave in own {
            let home = [VALVE_AND_PROCESS, NOT_SPLIT, DISTURBANCE];
            let at = home.iter().find_map(|id| kept.iter().position(|p| p.id == *id));
            if let Some(part) = at.and_then(|at| kept.get_mut(at)) {
                part.take_over(wave.share_pct, wave.sd);
            } else {
                kept.push(wave);
            }
        }
        *parts = kept;
    }

    /// The part of valve and process that ends with the friction is the friction's.
    fn book_friction(&self, parts: &mut Vec<PartNote>) {
        let Some(share) = self.of_friction else { return };
        let Some(from) = parts.iter().position(|p| p.id == VALVE_AND_PROCESS) else { return };
        let whole = &mut parts[from];
        let moved = (100.0 * share).min(whole.share_pct);
        if moved <= 0.0 {
            return;
        }
        let left = whole.share_pct - moved;
        let sd = whole.sd * (moved / whole.share_pct).sqrt();
        whole.sd *= (left / whole.share_pct).max(0.0).sqrt();
        whole.share_pct = left;
        match parts.iter_mut().find(|p| p.id == stiction::EFFECT.id) {
            Some(own) => own.take_over(moved, sd),
            None => parts.insert(from + 1, PartNote::plain(stiction::EFFECT.id, moved, sd)),
        }
    }
}

/// Whether a parameter is a size, not a time or a kind.
fn is_size(name: &str, unit: &str) -> bool {
    unit != "s" && !["straight", "by_level", "from_op", "p_value"].contains(&name)
}

/// Whether two sizes have one sign and are within a factor.
fn agree(x: f64, y: f64) -> bool {
    x * y > 0.0 && x.abs().max(y.abs()) <= MOST_RATIO * x.abs().min(y.abs())
}

#[cfg(test)]
mod tests {
    use super::super::document::GapDocument;
    use super::super::sizes::Quantity;
    use super::*;

    fn document() -> GapDocument {
        serde_json::from_str(include_str!("../../../tests/golden/gap-sinusoid.json")).unwrap()
    }

    fn sized(sizes: &[(&str, f64, &str)]) -> std::collections::BTreeMap<String, Quantity> {
        let one = |(name, value, unit): &(&str, f64, &str)| {
            ((*name).to_owned(), Quantity { value: *value, unit: (*unit).to_owned() })
        };
        sizes.iter().map(one).collect()
    }

    fn part(id: &str, share_pct: f64, sizes: &[(&str, f64, &str)]) -> PartNote {
        let base = document().budget.unwrap().parts.remove(0);
        let parameters = sized(sizes);
        PartNote { id: id.to_owned(), share_pct, parameters, gain_nats: None, confirmed: Some(true), ..base }
    }

    fn effect(id: &str, sizes: &[(&str, f64, &str)], closed: f64) -> EffectNote {
        let base = document().effects.remove(0);
        EffectNote { id: id.to_owned(), parameters: sized(sizes), closed_pct: Some(closed), ..base }
    }

    /// The parts after they were held against one effect and a limit cycle of 73.8 s, of which friction makes 0.8.
    fn settled(parts: Vec<PartNote>, effects: &[EffectNote], of_friction: Option<f64>) -> Vec<PartNote> {
        let mut budget = document().budget.unwrap();
        budget.parts = parts;
        let cycle_s = Some(73.8);
        Known { effects, cycle_s, of_friction, record_s: 3_000.0, answer_s: 40.0, sp_moves: &[], point_s: 1.0 }
            .settle(&mut budget);
        budget.parts
    }

    #[test]
    fn a_step_that_both_found_has_one_size_and_is_confirmed_only_where_they_agree() {
        let step = |size: f64, at: f64| [("size", size, "PV"), ("at", at, "s")];
        let found = effect("step_load", &step(5.81, 1473.0), 36.0);
        let said = |size: f64, at: f64| {
            let parts = settled(vec![part("step_load", 1.0, &step(size, at))], core::slice::from_ref(&found), None);
            let value = |name: &str| parts[0].parameters[name].value;
            (value("size"), value("at"), parts[0].confirmed)
        };
        assert_eq!(said(-0.0232, 1496.0), (5.81, 1473.0, Some(false)));
        assert_eq!(said(4.0, 1496.0), (5.81, 1473.0, Some(true)));
        assert_eq!(said(-2.0, 2200.0), (-2.0, 2200.0, Some(true)), "another step");
        let hardly = effect("step_load", &step(5.81, 1473.0), 3.0);
        let kept = settled(vec![part("step_load", 1.0, &step(4.0, 1496.0))], &[hardly], None);
        assert_eq!(kept[0].parameters["size"].value, 4.0);
    }

    #[test]
    fn a_wave_of_the_limit_cycles_period_is_the_valves_own() {
        let wave = |period: f64| part(sinusoid::EFFECT.id, 40.0, &[("period", period, "s")]);
        let of = |period: f64| settled(vec![part(VALVE_AND_PROCESS, 50.0, &[]), wave(period)], &[], None);
        let own = of(76.4);
        assert!(own.len() == 1 && own[0].share_pct == 90.0, "{own:?}");
        assert_eq!(of(120.0).len(), 2);
    }

    #[test]
    fn a_gain_that_more_than_doubles_with_an_op_unit_is_not_confirmed() {
        let said = |change: f64| {
            let parts = vec![part("static_nonlinearity", 5.0, &[("gain_change_per_op", change, "1/OP")])];
            settled(parts, &[], None)[0].confirmed
        };
        assert_eq!([said(2.16), said(-1.2), said(0.11)], [Some(false), Some(false), Some(true)]);
    }

    #[test]
    fn the_variance_of_a_cycle_that_ends_with_the_friction_is_the_frictions() {
        let parts = settled(vec![part(VALVE_AND_PROCESS, 96.0, &[]), part("noise", 4.0, &[])], &[], Some(0.8));
        let shares: Vec<(&str, f64)> = parts.iter().map(|p| (p.id.as_str(), p.share_pct.round())).collect();
        assert_eq!(shares, [(VALVE_AND_PROCESS, 16.0), ("stiction", 80.0), ("noise", 4.0)]);
        let linear = settled(vec![part(VALVE_AND_PROCESS, 96.0, &[]), part("stiction", 3.0, &[])], &[], Some(0.99));
        let shares: Vec<f64> = linear.iter().map(|p| p.share_pct.round()).collect();
        assert_eq!(shares, [0.0, 99.0]);
    }
}

//! A diagnosis in words that can be read aloud.

mod budget;
mod claim;
mod effect;
mod place;

use crate::core::gap::document::{EffectNote, GapDocument};
use crate::core::gap::effects;
use crate::core::gap::loop_run::Cycles;
use crate::core::gap::sizes::percent;
use crate::core::gap::types::{Compared, FromSp, NONE, NextTest, UNKNOWN};
use crate::core::gap::valve_note::ValveNote;
use crate::core::units::{duration, number, probability};
pub use budget::{BudgetText, PartText, budget, tellable};
use claim::Claim;

/// The title of a diagnosis: the valve's verdict and size, or the answer on the gap where the valve was not judged.
#[must_use]
pub fn title(d: &GapDocument) -> String {
    let alone = || format!("{} (p {})", answer(d), probability(d.cause.probability));
    d.valve.as_ref().map_or_else(alone, ValveNote::title)
}

/// The answer as one paragraph: the valve, then the gap.
#[must_use]
pub fn paragraph(d: &GapDocument) -> String {
    let valve = d.valve.as_ref().map_or_else(String::new, |valve| sentence(&valve.title()) + " ");
    valve + &of_gap(d)
}

/// The answer on the gap alone: where it is, which effect, how far, what it is indistinguishable from, what would settle it.
#[must_use]
pub fn of_gap(d: &GapDocument) -> String {
    let mut parts = Vec::new();
    parts.extend(split_of_given(d));
    parts.push(match d.cause.id.as_str() {
        _ if d.good_enough.is_some() => good_enough(d),
        NONE => nothing(d),
        UNKNOWN => not_in_the_catalogue(d),
        _ => d.named().map_or_else(|| without_fit(d), |e| named(d, e)),
    });
    parts.extend(budget::why_unsure(d).filter(|_| d.good_enough.is_none()));
    parts.extend(beside(d));
    if let Some(test) = &d.next_test {
        parts.push(bump(test));
    }
    if d.stopped_early {
        parts.push("the search ended early, so a better answer may exist (--budget gives it more time)".to_owned());
    }
    sentence(&parts.join("; "))
}

/// That the model is good enough, as a clause.
fn enough(d: &GapDocument) -> Option<String> {
    let e = d.good_enough?;
    let which = if d.given.is_some() { "the refitted model" } else { "the model" };
    let limit = if e.is_noise {
        format!("PV's noise ({} %)", number(e.limit_pct))
    } else {
        format!("the limit of {} %", number(e.limit_pct))
    };
    Some(format!("{which} is good enough: what is left is {} % of PV's movement, below {limit}", number(e.left_pct)))
}

/// The same with what shows in the little that is left.
fn good_enough(d: &GapDocument) -> String {
    let shows = |e: &EffectNote| {
        format!("; in what is left, {} shows (p {})", effect::phrase(e), probability(d.cause.probability))
    };
    enough(d).unwrap_or_default() + &d.leading().map_or_else(String::new, shows)
}

/// A cause that the search had no time to fit a free run with.
fn without_fit(d: &GapDocument) -> String {
    format!("{} {}", effect::noun(&d.cause.id), Claim::Shows.words(d.cause.probability))
}

/// What the comparison with other loops gave, where there are any.
#[must_use]
pub fn other_loops(d: &GapDocument) -> Option<String> {
    d.neighbours.as_ref().map(compared_loops)
}

fn compared_loops(compared: &Compared) -> String {
    let best = compared.best.as_ref().zip(compared.share).map_or_else(String::new, |(name, share)| {
        let p =
            compared.p_value.map_or_else(|| "too few periods for a p-value".to_owned(), |p| format!("p {}", number(p)));
        format!("; the past of {name} predicts PV best, {} less error than without it ({p})", percent(100.0 * share))
    });
    let acts = compared.acts.as_ref().map_or_else(
        || "none acts on PV in both halves of the record".to_owned(),
        |name| format!("{name} acts on PV in both halves of the record"),
    );
    format!("{} compared{best}; {acts}", compared.offered)
}

/// A test by moves of OP.
fn bump(test: &NextTest) -> String {
    let [a, b] = &test.separates;
    format!(
        "step {} up by {}, back, down by the same and back, and hold each for {}: this distinguishes {} from {} (p {})",
        test.signal.to_uppercase(),
        number(test.size),
        duration(test.duration_s),
        effect::noun(a),
        effect::noun(b),
        probability(test.p)
    )
}

/// Three lines for a planner: what the model leaves and why; what to measure next; what that costs.
#[must_use]
pub fn summary(d: &GapDocument) -> [String; 3] {
    let (next, cost) = next(d);
    [conclusion(d), format!("Measure next: {next}."), format!("Cost: {cost}.")]
}

/// What to measure next, and what that costs.
fn next(d: &GapDocument) -> (String, String) {
    let nothing = || ("nothing".to_owned(), "none".to_owned());
    if d.good_enough.is_some() {
        return nothing();
    }
    if let Some(test) = &d.next_test {
        let [total, size, pv] = [duration(test.total_s), number(test.size), number(test.moves_pv)];
        return (bump(test), format!("{total} in manual, OP moved by {size} both ways, PV by about {pv}"));
    }
    let asked = d.leading().map_or("", |e| e.separated_by.as_str());
    let asked = if asked.is_empty() { "the valve position beside OP and PV" } else { asked };
    let is_recorded = d.location.op_to_mv.is_some() || d.valve.as_ref().is_some_and(|valve| valve.position.is_some());
    let asked = if is_recorded { beside_position(asked) } else { Some(asked.to_owned()) };
    let told =
        asked.map(|asked| (asked.replace("; ", ", or "), "a measurement; the loop stays in automatic".to_owned()));
    told.unwrap_or_else(nothing)
}

/// What remains of a request where the valve position is in the record.
fn beside_position(asked: &str) -> Option<String> {
    let other = |part: &&str| !part.starts_with("the valve position") || part.contains(" OP");
    let rest = |part: &str| {
        let moved = part.strip_prefix("the valve position").and_then(|rest| {
            let rest = rest.strip_prefix(" during ").or_else(|| rest.strip_prefix(" after "));
            rest.filter(|_| !part.contains("beside"))
        });
        moved.map_or_else(|| part.to_owned(), str::to_owned)
    };
    let parts: Vec<String> =
        asked.split(", or ").filter(other).map(rest).filter(|part| !part.starts_with("the valve position")).collect();
    (!parts.is_empty()).then(|| parts.join(", or "))
}

/// What the recorded valve position shows, where there is one.
fn position(d: &GapDocument) -> Option<String> {
    Some(sentence(&d.valve.as_ref()?.position.as_ref()?.words()))
}

fn conclusion(d: &GapDocument) -> String {
    if let Some(enough) = enough(d) {
        return sentence(&enough);
    }
    let no_confirmed_lead = d.cause.id != NONE && (!d.cause.confirmed || d.leading().is_none());
    let of_cause = of_rest(d, of_cause(d));
    match budget::confirmed(d).filter(|_| no_confirmed_lead) {
        Some(parts) => format!("{of_cause} {parts}"),
        None => of_cause,
    }
}

/// Beside a valve that sticks, only the rest is unknown.
fn of_rest(d: &GapDocument, conclusion: String) -> String {
    let sticks = d.valve.as_ref().is_some_and(ValveNote::does_stick);
    match (conclusion.strip_prefix("Unknown: "), d.gap.relative.filter(|_| sticks)) {
        (Some(rest), Some(left)) => {
            format!("What the model leaves, {} of PV's movement, is not explained: {rest}", percent(100.0 * left))
        }
        _ => conclusion,
    }
}

fn of_cause(d: &GapDocument) -> String {
    let p = probability(d.cause.probability);
    if d.cause.id == NONE {
        return format!("No further effect: {} {} (p {p}).", base_of(d), claim::of_base(d));
    }
    if let Some(why) = worse_than_mean(d) {
        return why;
    }
    let Some(e) = d.leading() else {
        return match d.named() {
            Some(e) => {
                format!(
                    "Unknown: {} shows in the record, but closes less than a tenth of the gap.",
                    effect::noun(&e.id)
                )
            }
            None if effects::kind(&d.cause.id) == effects::neighbour::EFFECT.id => {
                format!("Outside the valve: {}.", without_fit(d))
            }
            None => budget::cannot_be_told(d)
                .unwrap_or_else(|| format!("Unknown: no effect of the catalogue explains the gap (p {p}).")),
        };
    };
    let closed = e.closed_pct.map_or_else(String::new, |c| format!(", closes {} of the gap", claim::closed(c)));
    let what = format!("{}{closed} (p {p})", effect::phrase(e));
    if !d.cause.confirmed {
        return format!("Unknown: suspected, not confirmed: {what}.");
    }
    match e.stage.name() {
        "valve" => format!("The valve: {what}."),
        stage if d.base.valve_model == "none" => format!("Outside the valve ({stage}): {what}."),
        stage => format!("Outside the valve ({stage}): {what}. The base has a sticking valve; `analyze` judges that."),
    }
}

/// The conclusion where nothing can be judged from the base.
fn worse_than_mean(d: &GapDocument) -> Option<String> {
    let left = d.gap.relative.filter(|_| d.is_worse_than_mean())?;
    Some(format!(
        "Unknown: the base model leaves {} of PV's standard deviation on held-out data, more than PV's mean does. Choose a section \
         without trips, trends and data gaps in which OP moves PV, or check that OP and PV are not swapped.",
        percent(100.0 * left)
    ))
}

/// The windows that were decided together, where there are several.
#[must_use]
pub fn windows(d: &GapDocument) -> Option<String> {
    let each = d.pooled.iter().map(|w| {
        let shown = if w.shown { ", shown here" } else { "" };
        format!("{}: {} (p {}{shown})", w.source, w.cause, probability(w.probability))
    });
    (!d.pooled.is_empty())
        .then(|| format!("{} together; alone {}", d.pooled.len(), each.collect::<Vec<_>>().join(", ")))
}

/// Begins with a capital and ends with a full stop.
#[must_use]
pub fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().map(|c| c.to_uppercase().to_string()).unwrap_or_default();
    format!("{first}{}.", letters.as_str())
}

/// As given, refitted, left: only where a model was given.
fn split_of_given(d: &GapDocument) -> Option<String> {
    let (given, parametric) = (d.given?, d.parametric?);
    if given.gap <= 0.0 {
        return Some("the given model leaves nothing above the noise".to_owned());
    }
    let share = 100.0 * parametric / given.gap;
    let left = number(given.gap);
    Some(if share < 5.0 {
        format!("the given model leaves a gap of {left} PV units, and refitting it gains next to nothing")
    } else if share > 95.0 {
        format!(
            "the given model leaves a gap of {left} PV units, and refitting its numbers closes {}: the loop has changed \
             in its numbers, not in its kind",
            percent(share)
        )
    } else {
        format!(
            "the given model leaves a gap of {left} PV units: refitting its numbers closes {}, the other {} is something \
             that it leaves out",
            percent(share),
            percent(100.0 - share)
        )
    })
}

fn base_of(d: &GapDocument) -> &'static str {
    if d.base.valve_model == "none" {
        "a first-order process behind a valve without friction"
    } else {
        "a sticking valve before a first-order process"
    }
}

fn share_of_pv(d: &GapDocument) -> String {
    d.gap.relative.map_or_else(String::new, |r| format!(", {} of PV's standard deviation", percent(100.0 * r)))
}

fn nothing(d: &GapDocument) -> String {
    let left = match d.gap.noise_floor {
        Some(_) if claim::nothing_left(d) => format!("what is left is noise ({} PV units)", number(d.gap.rmse)),
        Some(_) => format!("{} PV units are left above the noise{}", number(d.gap.gap), share_of_pv(d)),
        None => {
            format!("{} PV units are left{}, and PV shows no noise to compare with", number(d.gap.gap), share_of_pv(d))
        }
    };
    let p = probability(d.cause.probability);
    format!("{} {}: {left}; no unmodelled effect shows (p {p})", base_of(d), claim::of_base(d))
}

fn not_in_the_catalogue(d: &GapDocument) -> String {
    let best = d.effects.iter().filter(|e| e.closed_pct.is_some()).max_by(|a, b| a.evidence.total_cmp(&b.evidence));
    let (asked, p) = (d.effects.len(), probability(d.cause.probability));
    let unexplained = match best {
        Some(e) if claim::explains(e) => format!(
            "that none of the {asked} effects tried is sure to explain (p {p}); the best of them, {}, closes {} on data \
             it was not fitted to, and so might others",
            effect::noun(&e.id),
            claim::closed(e.closed_pct.unwrap_or(0.0))
        ),
        Some(e) => format!(
            "that none of the {asked} effects tried explains (p {p}); the best of them, {}, closes {} on data it was not \
             fitted to",
            effect::noun(&e.id),
            claim::closed(e.closed_pct.unwrap_or(0.0))
        ),
        None => format!("that none of the {asked} effects tried explains (p {p})"),
    };
    let size = if claim::nothing_left(d) {
        "more by its course than by its size, which is the noise's".to_owned()
    } else {
        format!("{} PV units above the noise{}", number(d.gap.gap), share_of_pv(d))
    };
    format!("{}; something departs from the model ({size}) {unexplained}", place::headline(d))
}

fn named(d: &GapDocument, e: &EffectNote) -> String {
    let what = effect::phrase(e);
    let claim = Claim::of(d, e);
    let mut text = format!("{}; {what} {}", place::headline(d), claim.words(d.cause.probability));
    match (e.closed_pct, e.floor_after) {
        (Some(pct), _) => {
            text.push_str(&format!("; adding it closes {}", claim::closed(pct)));
            if let Some([low, high]) = e.closed_interval.filter(|[_, high]| *high > 0.0) {
                text.push_str(&format!(" ({low:.0} to {high:.0})"));
            }
            text.push_str(" on data it was not fitted to");
            if let Some(pct) = claim::closed_forward(d).filter(|_| claim != Claim::Hardly) {
                text.push_str(&format!(", {} forward in time", claim::closed(pct)));
            }
        }
        (None, Some(floor)) => text.push_str(&format!(
            "; no simulation can close it, because it raises what can be predicted at best to {} PV units",
            number(floor)
        )),
        (None, None) if is_recorder(&e.id) && d.gap.noise_floor.is_none() => text.push_str(
            "; its stored values are too few, or the record too long, to tell how much of the gap is its doing",
        ),
        (None, None) => {}
    }
    if claim == Claim::Hardly {
        // What it is indistinguishable from would make as little of the gap.
        return text;
    }
    let twins = effect::twins(d, e);
    if !twins.is_empty() {
        text.push_str(&format!("; in this record it is indistinguishable from {}", twins.join(" or ")));
    }
    let rivals: Vec<String> = d
        .alternatives
        .iter()
        .take(2)
        .filter(|a| a.probability >= 0.05 && !e.confusable_with.contains(&a.id))
        .map(|a| format!("{} (p {})", effect::noun(&a.id), probability(a.probability)))
        .collect();
    if !rivals.is_empty() {
        text.push_str(&format!("; not excluded: {}", rivals.join(", ")));
    }
    if !e.separated_by.is_empty() {
        text.push_str(&format!("; {} would settle it", e.separated_by.replace("; ", ", or ")));
    }
    text
}

/// Whether an effect is what a recorder did to PV.
fn is_recorder(id: &str) -> bool {
    effects::by_id(id).is_some_and(|e| e.recorder.is_some())
}

/// What is named beside the cause.
fn beside(d: &GapDocument) -> Option<String> {
    let second = d.second_cause.as_ref()?;
    let effect = d.effects.iter().find(|e| e.id == second.id)?;
    let (what, p) = (effect::phrase(effect), probability(second.probability));
    if effect.at_floor.is_none() {
        // What leaves a trace in PV is there; the cause's own figures already went through it.
        return Some(format!("the record shows {what}, too (p {p})"));
    }
    let closed = claim::closed(effect.closed_pct.unwrap_or(0.0));
    Some(format!(
        "beside it, {what} shows (p {p}): with it no more than noise is left where it was fitted, and {closed} of the gap \
         is closed on data it was not fitted to"
    ))
}

/// The answer in a few words: `extra_lag, suspected`, `swinging_door, with slip_overshoot`.
#[must_use]
pub fn answer(d: &GapDocument) -> String {
    let first = first(d);
    d.second_cause.as_ref().map_or_else(|| first.clone(), |second| format!("{first}, with {}", second.id))
}

fn first(d: &GapDocument) -> String {
    let id = &d.cause.id;
    if d.good_enough.is_some() {
        return "good enough".to_owned();
    }
    match d.named().map(|e| Claim::of(d, e)) {
        Some(_) if d.leading().is_none() => format!("{UNKNOWN}; beside it {id}, next to nothing of the gap"),
        Some(Claim::Suspected) => format!("{id}, suspected"),
        None if !d.cause.confirmed && ![NONE, UNKNOWN].contains(&id.as_str()) => format!("{id}, suspected"),
        _ => id.clone(),
    }
}

/// The cycle as measured and as the closed loop makes it.
#[must_use]
pub fn cycles(c: &Cycles) -> String {
    place::cycles(c)
}

/// What the closed loop predicts from SP alone.
#[must_use]
pub fn from_sp(f: &FromSp) -> String {
    let averaged = f.averaged_s.map_or_else(String::new, |s| format!(", averaged over {}", duration(s)));
    let share = |pct: f64| if pct < 0.0 { "nothing".to_owned() } else { percent(pct) };
    let after = f.after_pct.map_or_else(String::new, |pct| format!(", with the cause {}", share(pct)));
    format!(
        "the closed loop with the base, fitted to the first part, predicts {} of PV's variance in the rest{averaged}{after}; \
         PV = SP would predict {}",
        share(f.base_pct),
        share(f.sp_pct)
    )
}

/// A diagnosis in a title and three lines, with a fourth where the valve position is recorded.
#[must_use]
pub fn report(d: &GapDocument) -> String {
    let lines = position(d).into_iter().chain(summary(d)).map(|line| format!("  {line}"));
    std::iter::once(format!("{}: {}", d.loop_name, title(d))).chain(lines).collect::<Vec<_>>().join("\n")
}

/// The same with everything behind it: the answer with its probability, the paragraph, then the figures.
#[must_use]
pub fn verbose(d: &GapDocument) -> String {
    let mut answer = format!("{} (p {})", first(d), probability(d.cause.probability));
    if let Some(second) = &d.second_cause {
        answer.push_str(&format!(", with {} (p {})", second.id, probability(second.probability)));
    }
    let mut lines = vec![report(d), format!("  In detail: {}", paragraph(d))];
    let mut row = |name: &str, value: String| lines.push(format!("  {name:<12} {value}"));
    row("answer", answer);
    let floor = d.gap.noise_floor.map_or("unknown".to_owned(), number);
    row(
        "gap",
        format!(
            "{} PV units{} (rms error {}, noise floor {floor})",
            number(d.gap.gap),
            share_of_pv(d),
            number(d.gap.rmse)
        ),
    );
    if let Some(windows) = windows(d) {
        row("windows", windows);
    }
    if let Some(given) = d.given {
        row("given model", format!("gap {} PV units (rms error {})", number(given.gap), number(given.rmse)));
    }
    if let Some(mv) = &d.location.mv_to_pv {
        let of_mv = d.location.op_to_mv.map_or(0.0, |o| o.unexplained_pct);
        row(
            "with MV",
            format!(
                "OP to valve position: {of_mv:.1} % unexplained; valve position to PV: gap {} PV units",
                number(mv.gap)
            ),
        );
    }
    place::rows(d, &mut row);
    for (rank, e) in d.effects.iter().chain(&d.pairs).filter(|e| e.evidence > 0.0).take(5).enumerate() {
        let closed = match (e.closed_pct, e.closed_interval) {
            (Some(pct), Some([low, high])) if high > 0.0 => {
                format!("closes {} ({low:.0} to {high:.0})", claim::closed(pct))
            }
            (Some(pct), _) => format!("closes {}", claim::closed(pct)),
            (None, _) => "free run cannot show it".to_owned(),
        };
        let name = if rank == 0 { "effects" } else { "" };
        row(name, format!("{:<20} evidence {:+.2}, {closed}: {}", e.id, e.evidence, effect::phrase(e)));
    }
    if let Some(f) = &d.from_sp {
        row("from SP", from_sp(f));
    }
    if let Some(f) = d.forward {
        row("forward", format!("gap {} before, {} after", number(f.gap_before), number(f.gap_after)));
    }
    if let Some(cycles) = &d.closed_loop {
        row("closed loop", place::cycles(cycles));
    }
    budget::rows(d, &mut row);
    if let Some(compared) = other_loops(d) {
        row("other loops", compared);
    }
    let cut = if d.stopped_early { ", cut short" } else { "" };
    row("search", format!("{} model responses{cut}", d.evaluations));
    lines.join("\n")
}

#[cfg(test)]
mod tests;

//! The figures as text for people.

use core::fmt::{self, Display, Formatter};

use super::figures::{Figures, Group, Rate};

impl Display for Rate {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let text = match self.share {
            Some(share) => format!("{share:.2} ({}/{})", self.right, self.of),
            None => "-".to_owned(),
        };
        f.pad(&text)
    }
}

fn pct(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{v:.1}"))
}

impl Figures {
    /// All figures as tables.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        let mut line = |text: String| {
            out.push_str(text.trim_end());
            out.push('\n');
        };
        line(format!(
            "Challenge of seed {}, split {}; {} recordings could not be diagnosed",
            self.seed, self.split, self.errors
        ));
        line(String::new());
        self.summary().into_iter().for_each(&mut line);
        line(String::new());
        self.parts().into_iter().for_each(&mut line);
        line(String::new());
        self.by_effect().into_iter().for_each(&mut line);
        line(String::new());
        line("calls of at least p   answer rate       precision".to_owned());
        for point in &self.curve {
            line(format!("{:<21.2} {:<17} {}", point.p, point.coverage, point.precision));
        }
        line(String::new());
        line("probability given     mean   right   cases".to_owned());
        for bin in &self.reliability {
            line(format!("{:.2} to {:<12.2}  {:.2}   {:.2}    {}", bin.from, bin.to, bin.mean_p, bin.rate, bin.count));
        }
        out
    }

    fn summary(&self) -> Vec<String> {
        let Some(all) = self.groups.first() else { return vec![] };
        let interval = |rate: &Rate| {
            rate.interval.map_or_else(String::new, |[low, high]| format!("  95 % interval {low:.2} to {high:.2}"))
        };
        let row = |name: &str, rate: &Rate| format!("{name:<52} {rate:<15}{}", interval(rate));
        let closed = |name: &str, value: Option<f64>| format!("{name:<52} {} %", pct(value));
        vec![
            row("known effects named rightly (top 1)", &all.top1),
            row("right one named or first alternative (top 2)", &all.top2),
            row("stage right", &all.stage),
            row("known effects answered with an effect (answer rate)", &all.coverage),
            row("named calls that are right (precision)", &all.precision),
            row("loops without effect, an effect named", &all.named_false_alarms),
            row("loops without effect, anything but none", &all.all_false_alarms),
            row("effects no catalogue has, called unknown", &all.unknown_foreign),
            row("known effects withheld, called unknown", &all.unknown_withheld),
            row("the same, stated class-mates counted", &all.unknown_or_mate_withheld),
            row("two effects at once, one of them named", &all.pairs),
            row("two effects at once, both named", &all.both),
            row("effects named beside another that are right", &all.beside),
            row("confirmed calls that are right", &self.confirmed),
            row("suspected calls that are right", &self.suspected),
            row("true effect's own fit at the noise floor", &all.true_fit_at_floor),
            row("base at the noise floor, loops without effect", &all.base_at_floor),
            closed("gap closed by right calls, median", all.closed_right_pct),
            closed("gap closed by wrong calls, median", all.closed_wrong_pct),
            format!(
                "{:<52} {}",
                "Brier score of the probabilities",
                self.brier.map_or("-".to_owned(), |b| format!("{b:.3}"))
            ),
        ]
    }

    fn parts(&self) -> Vec<String> {
        let head =
            ["top 1", "top 2", "stage", "answer rate", "precision", "false pos.", "unknown", "withheld", "closed %"];
        let head: String = head.iter().map(|h| format!("{h:<15}")).collect();
        let row = |g: &Group| {
            let rates = [
                g.top1,
                g.top2,
                g.stage,
                g.coverage,
                g.precision,
                g.named_false_alarms,
                g.unknown_foreign,
                g.unknown_withheld,
            ];
            let cells: String = rates.iter().map(|r| format!("{r:<15}")).collect();
            format!("{:<20}{cells}{}", g.name, pct(g.closed_right_pct))
        };
        core::iter::once(format!("{:<20}{head}", "cases")).chain(self.groups.iter().map(row)).collect()
    }

    fn by_effect(&self) -> Vec<String> {
        let head = format!(
            "{:<22}{:<8}{:<11}{:<15}{:<15}{:<10}{:<10}{:<10}{:<9}{}",
            "effect", "cases", "expressed", "answered", "withheld", "gap %", "with it", "oracle", "noise %", "closed %"
        );
        let rows = self.effects.iter().filter(|e| e.cases > 0).map(|e| {
            format!(
                "{:<22}{:<8}{:<11}{:<15}{:<15}{:<10}{:<10}{:<10}{:<9}{}",
                e.effect,
                e.cases,
                e.expressed,
                e.named,
                e.unknown,
                pct(e.gap_without_pct),
                pct(e.gap_with_pct),
                pct(e.gap_oracle_pct),
                pct(e.noise_pct),
                pct(e.closed_pct)
            )
        });
        core::iter::once(head).chain(rows).collect()
    }
}

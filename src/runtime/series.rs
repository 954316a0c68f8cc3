//! Metrics for single loops in `/metrics`, as needed by alert rules and dashboards, for a bounded number of loops.

use std::collections::HashMap;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

use stiction::core::verdict::Assessment;
use stiction_engine::alarm::{AlarmDocument, LoopContext, Priority, State};
use stiction_engine::config::Config;

/// Label that names the loop.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct Loop {
    r#loop: String,
}

/// Labels with the loop's name and configured context.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct About {
    r#loop: String,
    area: String,
    equipment: String,
    criticality: String,
}

impl About {
    fn new(name: &str, place: &LoopContext) -> Self {
        let text = |text: &Option<String>| text.clone().unwrap_or_default();
        Self {
            r#loop: name.to_owned(),
            area: text(&place.area),
            equipment: text(&place.equipment),
            criticality: place.criticality.map_or_else(String::new, |c| c.to_string()),
        }
    }
}

type Number = Family<Loop, Gauge<f64, AtomicU64>>;

/// The series.
#[derive(Debug, Default)]
pub struct LoopSeries {
    about: Family<About, Gauge>,
    active: Family<Loop, Gauge>,
    unacknowledged: Family<Loop, Gauge>,
    set_aside: Family<Loop, Gauge>,
    priority: Family<Loop, Gauge>,
    probability: Number,
    size: Number,
    data_age: Number,
    without: Gauge,
}

impl LoopSeries {
    /// Registers the series.
    pub fn register(&self, registry: &mut Registry) {
        registry.register("loop_about", "Area, equipment and criticality of a loop, always 1", self.about.clone());
        registry.register("loop_alarm_active", "Whether the stiction alarm's condition holds", self.active.clone());
        let help = "Whether the alarm waits for acknowledgement and was not put aside";
        registry.register("loop_alarm_unacknowledged", help, self.unacknowledged.clone());
        let help = "Whether the alarm is shelved, suppressed or out of service";
        registry.register("loop_alarm_set_aside", help, self.set_aside.clone());
        let help = "Priority of the active alarm: 1 low, 2 medium, 3 high, 4 urgent; 0 none";
        registry.register("loop_alarm_priority", help, self.priority.clone());
        let help =
            "Probability that the valve sticks, by the configured prevalence, of the newest window that could answer";
        registry.register("loop_stiction_probability", help, self.probability.clone());
        let help = "Dead band plus stick band s of the newest window with a fit, in units of OP";
        registry.register("loop_stiction_size", help, self.size.clone());
        let help = "Time between the newest stamp of a loop and now in seconds";
        registry.register("loop_data_age_seconds", help, self.data_age.clone());
        let help = "Loops without series of their own, beyond the limit";
        registry.register("loops_without_series", help, self.without.clone());
    }

    fn set(family: &Number, key: &Loop, value: Option<f64>) {
        match value {
            Some(value) => {
                family.get_or_create(key).set(value);
            }
            None => {
                family.remove(key);
            }
        }
    }
}

/// The loops that have series.
#[derive(Debug)]
pub struct LoopMetrics {
    /// Number of loops with series beyond the configured ones.
    room: usize,
    named: Vec<String>,
    /// Labels by name; `None` for a loop beyond the limit.
    keys: HashMap<String, Option<(Loop, About)>>,
}

impl LoopMetrics {
    /// Under this configuration; `None` if the series are switched off.
    #[must_use]
    pub fn new(config: &Config) -> Option<Self> {
        let limit = config.web.max_loop_series;
        let named: Vec<String> = config.loops.iter().take(limit).map(|l| l.name.clone()).collect();
        let on = config.web.enabled && config.web.loop_series;
        on.then(|| Self { room: limit - named.len(), named, keys: HashMap::new() })
    }

    /// Adopts new configured loops, which have series whatever the limit.
    pub fn name_loops(&mut self, config: &Config) {
        let limit = config.web.max_loop_series;
        self.named = config.loops.iter().take(limit).map(|l| l.name.clone()).collect();
        let unnamed = self.keys.iter().filter(|(name, key)| key.is_some() && !self.named.contains(name));
        self.room = (limit - self.named.len()).saturating_sub(unnamed.count());
    }

    /// Updates a loop's labels after an edit of the configuration.
    pub fn describe(&mut self, series: &LoopSeries, name: &str, place: &LoopContext) {
        let Some(Some((_, about))) = self.keys.get_mut(name) else { return };
        series.about.remove(about);
        *about = About::new(name, place);
        series.about.get_or_create(about).set(1);
    }

    /// Number of known loops.
    #[must_use]
    pub fn count(&self) -> usize {
        self.keys.len()
    }

    /// The labels of a loop; a new loop takes a place now.
    fn key(&mut self, series: &LoopSeries, name: &str, place: &LoopContext) -> Option<Loop> {
        if let Some(key) = self.keys.get(name) {
            return key.as_ref().map(|(key, _)| key.clone());
        }
        let named = self.named.iter().any(|n| n == name);
        if !named && self.room == 0 {
            self.keys.insert(name.to_owned(), None);
            series.without.inc();
            return None;
        }
        self.room -= usize::from(!named);
        let key = Loop { r#loop: name.to_owned() };
        let about = About::new(name, place);
        series.about.get_or_create(&about).set(1);
        self.keys.insert(name.to_owned(), Some((key.clone(), about)));
        Some(key)
    }

    /// Sets the values of a window.
    pub fn estimate(&mut self, series: &LoopSeries, name: &str, place: &LoopContext, a: &Assessment) {
        let Some(key) = self.key(series, name, place) else { return };
        // A window without an answer leaves the previous values; the age of the data shows how old they are.
        if a.stiction.is_some() {
            LoopSeries::set(&series.probability, &key, a.p_stiction);
            LoopSeries::set(&series.size, &key, a.s);
        }
    }

    /// Sets the values of an alarm.
    pub fn alarm(&mut self, series: &LoopSeries, name: &str, place: &LoopContext, d: &AlarmDocument) {
        let Some(key) = self.key(series, name, place) else { return };
        let aside = matches!(d.state, State::Shelved | State::Suppressed | State::OutOfService);
        let waits = matches!(d.state, State::Unack | State::RtnUnack);
        series.active.get_or_create(&key).set(i64::from(d.active));
        series.unacknowledged.get_or_create(&key).set(i64::from(waits));
        series.set_aside.get_or_create(&key).set(i64::from(aside));
        series.priority.get_or_create(&key).set(rank(d.priority));
    }

    /// Removes the series of a loop that has left the plant.
    pub fn forget(&mut self, series: &LoopSeries, name: &str) {
        match self.keys.remove(name) {
            None => {}
            Some(None) => drop(series.without.dec()),
            Some(Some((key, about))) => {
                series.about.remove(&about);
                for family in [&series.active, &series.unacknowledged, &series.set_aside, &series.priority] {
                    family.remove(&key);
                }
                for family in [&series.probability, &series.size, &series.data_age] {
                    family.remove(&key);
                }
                self.room += usize::from(!self.named.iter().any(|n| n == name));
            }
        }
    }

    /// Sets the age of a loop's data. A new loop's alarm counts as normal.
    pub fn age(&mut self, series: &LoopSeries, name: &str, place: &LoopContext, age_s: Option<f64>) {
        let Some(key) = self.key(series, name, place) else { return };
        LoopSeries::set(&series.data_age, &key, age_s);
        for family in [&series.active, &series.unacknowledged, &series.set_aside, &series.priority] {
            drop(family.get_or_create(&key));
        }
    }
}

const fn rank(priority: Option<Priority>) -> i64 {
    match priority {
        None => 0,
        Some(Priority::Low) => 1,
        Some(Priority::Medium) => 2,
        Some(Priority::High) => 3,
        Some(Priority::Urgent) => 4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::record::Record;
    use stiction::core::verdict::{AssessParams, SCREENED, assess};
    use stiction_engine::alarm::Alarm;

    #[test]
    fn named_loops_have_their_series_and_the_others_as_far_as_there_is_room() {
        let text =
            "[site]\nprefix = \"p\"\n[web]\nmax_loop_series = 2\n[[loop]]\nname = \"N\"\narea = \"a \\\"b\\\" \\\\\"\n";
        let config = Config::parse(text).unwrap();
        let (mut board, series) = (LoopMetrics::new(&config).unwrap(), LoopSeries::default());
        let place = LoopContext { area: Some("a \"b\" \\".into()), criticality: Some(3), ..LoopContext::default() };
        for name in ["A", "B", "N", "B"] {
            board.age(&series, name, &place, Some(2.5));
        }
        let record = Record::uniform(1.0, vec![1.0; 40], vec![1.0; 40]);
        let found = assess(&record, &AssessParams::default());
        let screened = Assessment { stiction: Some(false), reason: Some(SCREENED), ..found.clone() };
        for (name, a) in [("A", &Assessment { p_stiction: Some(0.4), ..screened.clone() }), ("N", &screened)] {
            board.estimate(&series, name, &place, a);
        }
        let document = Alarm::default().restored("N");
        board.alarm(&series, "N", &place, &AlarmDocument { active: true, state: State::Unack, ..document }.at(&place));
        let mut registry = Registry::with_prefix("stictiond");
        series.register(&mut registry);
        let mut text = String::new();
        prometheus_client::encoding::text::encode(&mut text, &registry).unwrap();
        for line in [
            "stictiond_loop_data_age_seconds{loop=\"A\"} 2.5",
            "stictiond_loop_alarm_active{loop=\"A\"} 0",
            "stictiond_loop_stiction_probability{loop=\"A\"} 0.4",
            "stictiond_loop_alarm_active{loop=\"N\"} 1",
            "stictiond_loop_alarm_priority{loop=\"N\"} 1",
            "stictiond_loops_without_series 1",
            "area=\"a \\\"b\\\" \\\\\"",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
        assert!(!text.contains("loop=\"B\""), "{text}");
        assert!(!text.contains("loop_stiction_probability{loop=\"N\"}"), "a screened loop has no probability: {text}");
        let off = Config::parse("[site]\nprefix = \"p\"\n[web]\nloop_series = false\n").unwrap();
        assert!(LoopMetrics::new(&off).is_none());
    }
}

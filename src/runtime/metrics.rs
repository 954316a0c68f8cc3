//! Counters of everything that arrives, is sent or is lost. They are plain atomics, so counting never waits.

use std::collections::BTreeMap;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::Registry;

use super::series::LoopSeries;
use stiction::samples::align::AlignCounts;

/// One label.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct Label {
    /// Its value.
    pub name: String,
}

/// Histogram of durations: a millisecond to half a minute, each bucket twice the previous one.
#[derive(Debug, Clone)]
pub struct LongDurations(pub Histogram);

impl Default for LongDurations {
    fn default() -> Self {
        Self(Histogram::new(exponential_buckets(0.001, 2.0, 16)))
    }
}

/// Histogram of a message's waiting time: a fifth of a millisecond to a quarter of a minute, each bucket 1.5 times the previous
/// one.
#[derive(Debug, Clone)]
pub struct ShortDurations(pub Histogram);

impl Default for ShortDurations {
    fn default() -> Self {
        Self(Histogram::new(exponential_buckets(0.0002, 1.5, 28)))
    }
}

macro_rules! counters {
    ($($field:ident: $help:literal),+ $(,)?) => {
        /// All counters and gauges of a daemon.
        #[derive(Debug, Default)]
        pub struct Metrics {
            $(#[doc = $help] pub $field: Counter,)+
            /// Estimates by verdict.
            pub verdicts: Family<Label, Counter>,
            /// Gates by name.
            pub gates: Family<Label, Counter>,
            /// Payloads by codec.
            pub codecs: Family<Label, Counter>,
            /// Documents that wait for receivers, by receiver.
            pub delivery_waiting: Family<Label, Gauge>,
            /// Duration of fits.
            pub fit: LongDurations,
            /// Time from the arrival of the sample that closes a window to its estimate.
            pub lag: LongDurations,
            /// Series of the single loops.
            pub series: LoopSeries,
            /// Time from a message's stamp on the bus, or else its arrival, to the engine.
            pub intake: ShortDurations,
            /// Duration of a comparison of all loops.
            pub comparison: LongDurations,
            /// Groups of loops that share one oscillation.
            pub groups: Gauge,
            /// Number of loops.
            pub loops: Gauge,
            /// Bytes of the loops in the engine.
            pub loop_bytes: Gauge,
            /// Finished recordings that were found damaged.
            pub recordings_damaged: Gauge,
            /// Queue lengths by name.
            pub queues: Family<Label, Gauge>,
            /// Samples that the aligners dropped or inserted, over all loops.
            pub aligned: Family<Label, Gauge<u64, AtomicU64>>,
        }

        impl Metrics {
            /// The plain counters by name, for the health documents.
            #[must_use]
            pub fn counters(&self) -> BTreeMap<&'static str, u64> {
                BTreeMap::from([$((stringify!($field), self.$field.get()),)+])
            }

            fn register_counters(&self, registry: &mut Registry) {
                $(registry.register(stringify!($field), $help, self.$field.clone());)+
            }
        }
    };
}

counters! {
    messages: "Messages received from the bus",
    samples: "Samples decoded",
    deletes: "Deletions received and ignored",
    dropped_input: "Messages dropped because the engine's queue was full",
    over_share: "Those of them whose key, or whose unknown keys together, held most of the queue",
    undecodable: "Messages whose payload could not be read",
    unmapped_values: "Values of bundles that are no signal of a loop",
    birth_names_lost: "Names of Sparkplug B births that were not kept, or were forgotten for those of nodes heard since",
    second_source: "Values ignored because another source feeds their signal",
    source_changes: "Times a signal was taken from another source because its own was silent",
    foreign_keys: "Messages under the prefix whose key names no signal",
    refused_loops: "Messages of loops that are not configured, or one too many",
    loops_over_limit: "Messages of new loops beyond max_loops or new_loops_per_hour",
    loops_forgotten: "Loops that left the memory: silent for forget_after_s, or removed from the configuration",
    over_rate: "Samples refused because their key sent more than max_rate_hz",
    stamps_ahead: "Samples refused because their stamp was too far ahead of the clock and the other loops",
    suspicious_quality: "Quality codes of 1 to 255 under the ua convention",
    windows: "Windows that came due",
    fits_skipped: "Windows whose fit was skipped",
    estimates: "Estimates made",
    alarms: "Alarm changes",
    gaps: "Gap diagnoses made",
    gaps_skipped: "Gap diagnoses refused, skipped or without an answer",
    comparisons_due: "Comparisons of all oscillating loops that came due",
    comparisons: "Comparisons done",
    group_documents: "Documents of groups of loops",
    group_answers: "Answers of groups passed to loops, withdrawals included",
    comparisons_left_out: "Comparisons left out because a newer one came due before they could start",
    gaps_cut: "Gap diagnoses whose search was ended before its budget",
    commands: "Commands carried out",
    commands_refused: "Commands refused",
    queries: "Queries received",
    queries_dropped: "Queries without an answer: too many waited, or whoever asked did not read",
    foreign_documents: "Documents under the daemon's keys that others published",
    published: "Documents published",
    dropped_output: "Documents that could not be published, or that a newer one of their key replaced",
    readers_behind: "Documents that met a reader of the bus that was too slow for them",
    delivered: "Documents that receivers outside the bus have taken",
    delivery_failed: "Attempts of delivery that failed and are made again",
    delivery_refused: "Documents that a receiver refused for good; they are in the dead-letter file",
    delivery_restarts: "Times a thread that delivers to a receiver panicked and was restarted",
    delivery_dropped: "Documents given up because too many waited for a receiver",
    recorded: "Messages recorded",
    recording_lost: "Messages that could not be recorded",
    recording_files: "Recording files opened",
    recordings_checked: "Finished recordings that were read to see whether they are whole",
    recordings_thinned: "Recordings whose samples the retention took out",
    recordings_removed: "Recordings that the retention removed",
    recording_errors: "Errors of the recording disk",
    states_stored: "Loop states stored beside the recordings",
    state_errors: "Errors of the store of loop states",
    states_damaged: "Stored loop states that were damaged at the start",
    quarantined: "Files put aside at the start because they cannot be used",
}

impl Metrics {
    /// A registry with these metrics, whose names start with `stictiond_`.
    #[must_use]
    pub fn registry(&self) -> Registry {
        let mut registry = Registry::with_prefix("stictiond");
        let build = [("version", stiction::core::VERSION)];
        registry.register("build", "Version of the program", Info::new(build));
        self.register_counters(&mut registry);
        registry.register("verdict", "Estimates by verdict", self.verdicts.clone());
        registry.register("gate", "Gates by name", self.gates.clone());
        registry.register("codec", "Payloads by codec", self.codecs.clone());
        registry.register("delivery_waiting", "Documents that wait for receivers", self.delivery_waiting.clone());
        registry.register("fit_seconds", "Time that a fit takes in seconds", self.fit.0.clone());
        let help = "Time from the arrival of the sample that closes a window to its estimate in seconds";
        registry.register("estimate_lag_seconds", help, self.lag.0.clone());
        self.series.register(&mut registry);
        registry.register("recordings_damaged", "Finished recordings found damaged", self.recordings_damaged.clone());
        let help = "Time from a message's stamp on the bus, or its arrival without one, to the engine in seconds, of every eighth";
        registry.register("intake_seconds", help, self.intake.0.clone());
        registry.register(
            "comparison_seconds",
            "Time that a comparison of all loops takes in seconds",
            self.comparison.0.clone(),
        );
        registry.register("groups", "Groups of loops that share one oscillation", self.groups.clone());
        registry.register("loops", "Loops that there are", self.loops.clone());
        registry.register("loop_bytes", "Bytes that the loops take in the engine", self.loop_bytes.clone());
        registry.register("queue_length", "Messages waiting", self.queues.clone());
        registry.register("aligner", "Samples dropped or put in by the aligners", self.aligned.clone());
        registry
    }

    /// Sets the totals of all loops' aligner counts.
    pub fn show_aligned(&self, sum: &AlignCounts) {
        let rows = [
            ("taken", sum.taken),
            ("duplicates", sum.duplicates),
            ("late", sum.late),
            ("bad", sum.bad),
            ("gaps", sum.gaps),
            ("filled", sum.filled),
            ("clock_resets", sum.clock_resets),
            ("stamp_outliers", sum.stamp_outliers),
            ("overflow", sum.overflow),
        ];
        for (name, value) in rows {
            self.aligned.get_or_create(&Label { name: name.into() }).set(value);
        }
    }
}

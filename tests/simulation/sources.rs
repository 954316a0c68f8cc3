//! A source starts to stick and is repaired while a follower goes on: days of a small plant through the whole daemon. The
//! signals come from closed loops with He's valve, and every window is assessed.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde_json::Value;
use stiction::sim::valve::he_step;
use stiction_monitor::codec::topic::Kind;
use stiction_monitor::config::Config;
use stictiond::daemon::clock::Clock;
use stictiond::daemon::stage::{Stage, no_receiver};
use stictiond::files::disk::{Disk, SystemDisk};

use super::refill::replays_to_the_byte;

/// Scan and sampling time, s.
const SCAN_S: i64 = 30;
const DAY_SCANS: i64 = 86_400 / SCAN_S;
const START_S: i64 = super::START_NS / 1_000_000_000;

/// A controlled first-order process behind a valve.
struct Plant {
    name: &'static str,
    /// Days on which the valve sticks.
    sticks: Vec<[f64; 2]>,
    /// Stickband and jump, time constant in scans.
    bands: [f64; 2],
    tau: f64,
    stem: f64,
    integral: f64,
    pv: f64,
    /// What the neighbour upstream adds, after its lag.
    pushed: f64,
}

impl Plant {
    fn new(name: &'static str, sticks: &[[f64; 2]], bands: [f64; 2], tau: f64) -> Self {
        Self { name, sticks: sticks.to_vec(), bands, tau, stem: 0.0, integral: 0.0, pv: 0.0, pushed: 0.0 }
    }

    fn sticks_at(&self, day: f64) -> bool {
        self.sticks.iter().any(|[from, to]| (*from..*to).contains(&day))
    }

    /// OP and PV of the next scan, from their rest.
    fn scan(&mut self, day: f64, upstream: f64, noise: f64) -> [f64; 2] {
        self.pushed += 0.3 * (upstream - self.pushed);
        let error = -self.pv;
        self.integral += error / 15.0;
        let op = 0.4 * error + 0.4 * self.integral;
        self.stem = if self.sticks_at(day) { he_step(self.stem, op, self.bands[0], self.bands[1]) } else { op };
        self.pv += (self.stem + self.pushed - self.pv) / self.tau;
        [op, self.pv + noise]
    }
}

/// The daemon, the plant, and what came out.
struct Site {
    clock: Clock,
    stage: Stage,
    plants: [Plant; 3],
    random: ChaCha8Rng,
    scan: i64,
    /// Documents of groups that went out, and whether the last one of each loop's alarm is active.
    groups: Vec<(f64, Value)>,
    alarms: BTreeMap<String, Vec<(f64, bool)>>,
    estimates: Vec<(f64, Value)>,
    comparisons: u64,
}

impl Site {
    fn new(dir: &Path) -> Self {
        let text = format!(
            "[site]\nprefix = \"p\"\n[window]\nhop_s = 14400.0\nmax_window_s = 43200.0\n[gap]\nenabled = false\n\
             [alarm]\nraise = [2, 3]\n[recording]\nmax_s = 1000000.0\ndir = {:?}\n",
            dir.to_str().unwrap()
        );
        let (config, clock) = (Config::parse(&text).unwrap(), Clock::standing(super::START_NS));
        let disk = Arc::new(SystemDisk) as Arc<dyn Disk>;
        Self {
            stage: Stage::start(config, &text, &clock, &disk, no_receiver).unwrap(),
            clock,
            plants: [
                Plant::new("SOURCE", &[[1.0, 3.0]], [3.0, 1.5], 6.0),
                Plant::new("FOLLOWER", &[[2.0, 5.0]], [2.0, 0.8], 4.0),
                Plant::new("ALONE", &[[0.0, 2.0]], [3.0, 1.0], 9.0),
            ],
            random: ChaCha8Rng::seed_from_u64(1),
            scan: 0,
            groups: Vec::new(),
            alarms: BTreeMap::new(),
            estimates: Vec::new(),
            comparisons: 0,
        }
    }

    fn day(&self) -> f64 {
        self.scan as f64 / DAY_SCANS as f64
    }

    fn noise(&mut self) -> f64 {
        0.05 * (f64::from(self.random.next_u32()) / f64::from(u32::MAX) - 0.5)
    }

    fn step(&mut self) {
        let (day, t_ns) = (self.day(), (START_S + self.scan * SCAN_S) * 1_000_000_000);
        let upstream = [0.0, 1.2 * self.plants[0].pv, 0.0];
        for (k, upstream) in upstream.into_iter().enumerate() {
            let noise = self.noise();
            let [op, pv] = self.plants[k].scan(day, upstream, noise);
            for (signal, value) in [("op", 50.0 + op), ("pv", 30.0 + pv)] {
                let json = format!("{{\"t\":{t_ns},\"v\":{value:.4}}}");
                self.stage.deliver(&format!("p/{}/{signal}", self.plants[k].name), json.as_bytes());
            }
        }
        self.stage.turn();
        self.stage.work(usize::MAX, |_, request| Some(request.compute().assessment));
        self.comparisons += u64::from(self.stage.compare());
        let published: Vec<_> = self.stage.published().collect();
        for publication in published {
            let document: Value = serde_json::from_slice(&publication.document.unwrap()).unwrap();
            match publication.kind {
                Kind::Group => self.groups.push((day, document)),
                Kind::Estimate => self.estimates.push((day, document)),
                Kind::Alarm => {
                    let name = document["loop"].as_str().unwrap().to_owned();
                    self.alarms.entry(name).or_default().push((day, document["active"].as_bool().unwrap()));
                }
                _ => {}
            }
        }
        self.stage.record();
        assert!(self.stage.keep());
        self.clock.advance(Duration::from_secs(SCAN_S as u64));
        self.scan += 1;
    }

    /// Days on which the alarm of a loop becomes active and ends.
    fn alarm_of(&self, name: &str) -> Vec<(f64, bool)> {
        let mut all = self.alarms.get(name).cloned().unwrap_or_default();
        all.dedup_by_key(|(_, active)| *active);
        all
    }
}

#[test]
fn a_followers_alarm_waits_while_the_source_sticks_and_comes_by_itself_once_that_is_repaired() {
    let dir = tempfile::tempdir().unwrap();
    let mut site = Site::new(&dir.path().join("rec"));
    while site.day() < 7.0 {
        site.step();
    }
    let named = |(_, group): &&(f64, Value)| {
        group["source"]["kind"] == "loop"
            && group["source"]["loop"] == "SOURCE"
            && group["members"].as_array().unwrap().len() == 2
    };
    let days: Vec<f64> = site.groups.iter().filter(named).map(|(day, _)| *day).collect();
    println!(
        "groups {:?}",
        site.groups
            .iter()
            .map(|(d, g)| (
                *d,
                g["source"]["kind"].as_str().unwrap().to_owned(),
                g["source"]["loop"].clone(),
                g["source"]["probability"].as_f64(),
                g["members"].to_string()
            ))
            .collect::<Vec<_>>()
    );
    println!("alarms {:?}", site.alarms);
    assert!(days.len() >= 15, "{days:?}");
    assert!(days[0] > 1.0 && days[0] < 1.6 && *days.last().unwrap() < 3.6, "{days:?}");
    assert_eq!(site.groups.iter().filter(|(_, group)| group["members"].to_string().contains("ALONE")).count(), 0);
    // The source's alarm comes and goes; the follower's comes when that has gone.
    let [source, follower, alone] = ["SOURCE", "FOLLOWER", "ALONE"].map(|name| site.alarm_of(name));
    assert!(
        matches!(source[..], [(raised, true), (ended, false)] if raised < 1.6 && ended > 3.0 && ended < 4.2),
        "{source:?}"
    );
    assert!(matches!(follower[..], [(raised, true), (_, false)] if raised > 3.0 && raised < 4.2), "{follower:?}");
    assert!(matches!(alone[..], [(raised, true)] if raised < 1.0), "{alone:?}");
    let held = site.estimates.iter().filter(|(_, e)| e["loop"] == "FOLLOWER" && e["reason"] == "masked").count();
    assert!(held >= 15, "{held} estimates are held");
    let metrics = site.stage.metrics();
    assert_eq!(metrics.group_documents.get(), site.groups.len() as u64);
    assert_eq!((metrics.comparisons.get(), metrics.comparisons_left_out.get()), (site.comparisons, 0));
    let documents = site.estimates.len() + site.groups.len();
    site.stage.finish();
    let compared = replays_to_the_byte(&dir.path().join("rec"));
    assert!(compared > documents, "{compared} documents were compared, {documents} went out");
}

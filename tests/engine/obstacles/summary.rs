//! The summary of data health is sent once when due, also over a restart, and compares with the previous day.

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::Value;
use stiction_engine::codec::topic::Kind;
use stiction_engine::config::{Config, Deliver};
use stiction_files::disk::{Disk, SystemDisk};
use stictiond::daemon::sim_daemon::SimDaemon;
use stictiond::daemon::sink::deliver::{Failure, Item, MakeTarget, Target};
use stictiond::runtime::clock::Clock;

/// Half past five, UTC.
const START_S: i64 = 20_000 * 86_400 + 5 * 3600 + 1800;
const HOUR: Duration = Duration::from_secs(3600);

/// A receiver that takes everything; clones share it.
#[derive(Clone, Default)]
struct Receiver(Arc<Mutex<Vec<Item>>>);

impl Target for Receiver {
    fn send(&mut self, item: &Item) -> Result<(), Failure> {
        self.0.lock().unwrap().push(item.clone());
        Ok(())
    }
}

impl Receiver {
    fn maker(&self) -> impl Fn(&Deliver) -> MakeTarget + use<> {
        let receiver = self.clone();
        move |_| {
            let receiver = receiver.clone();
            Box::new(move || Ok(Box::new(receiver.clone()) as Box<dyn Target>))
        }
    }

    fn last(&self) -> Value {
        serde_json::from_str(&self.0.lock().unwrap().last().unwrap().document).unwrap()
    }
}

/// A run that checks its data from time to time; `documents` are those it sent to the bus.
struct Run {
    stage: SimDaemon,
    clock: Clock,
    documents: usize,
}

impl Run {
    fn start(dir: &Path, clock: &Clock, receiver: &Receiver) -> Self {
        let text = format!(
            "[site]\nprefix = \"p\"\n[[loop]]\nname = \"A\"\n[[loop]]\nname = \"B\"\n[recording]\ndir = {:?}\n\
             [[deliver]]\nname = \"cmms\"\nto = \"http://127.0.0.1:1\"\ndocuments = [\"data_health\"]\n",
            dir.to_str().unwrap()
        );
        let (config, disk) = (Config::parse(&text).unwrap(), Arc::new(SystemDisk) as Arc<dyn Disk>);
        let stage = SimDaemon::start(config, &text, clock, &disk, receiver.maker()).unwrap();
        Self { stage, clock: clock.clone(), documents: 0 }
    }

    fn pass(&mut self, time: Duration) {
        self.clock.advance(time);
        self.stage.look_at_data();
        self.documents += self.stage.published().filter(|p| p.kind == Kind::DataHealth).count();
        assert!(self.stage.keep() && self.stage.send_out());
    }
}

#[test]
fn a_summary_is_sent_once_a_day_also_over_a_restart() {
    let dir = tempfile::tempdir().unwrap();
    let (clock, receiver) = (Clock::standing(START_S * 1_000_000_000), Receiver::default());
    let count = || receiver.0.lock().unwrap().len();
    let mut first = Run::start(dir.path(), &clock, &receiver);
    first.pass(HOUR / 4);
    assert_eq!(count(), 0, "loops have time for a window first");
    first.pass(HOUR);
    first.pass(HOUR);
    assert_eq!((count(), first.documents), (1, 1));
    let summary = receiver.last();
    assert_eq!(
        (&summary["schema"], &summary["due"]),
        (&"stictiond.data_health.v1".into(), &"2024-10-04T06:00:00Z".into())
    );
    assert_eq!((&summary["share"], &summary["change"], &summary["more"]), (&0.0.into(), &Value::Null, &0.into()));
    let began_ms = START_S as f64 * 1e3;
    let b = &summary["obstacles"][1];
    assert_eq!((&b["loop"], &b["kind"], &b["since_ms"]), (&"B".into(), &"silent".into(), &began_ms.into()));
    let item = receiver.0.lock().unwrap()[0].clone();
    assert_eq!((item.kind.as_str(), item.loop_name.as_str()), ("data_health", "@daemon/stage"));
    drop(first);

    let mut second = Run::start(dir.path(), &clock, &receiver);
    second.pass(2 * HOUR);
    second.pass(2 * HOUR);
    assert_eq!(count(), 1, "once a day");
    let trend = second.stage.overview().obstacles(clock.now()).trend;
    assert_eq!(trend.len(), 4, "an hour each, of both runs: {trend:?}");
    // The daemon is down when the next one comes due.
    drop(second);
    clock.advance(24 * HOUR);
    let mut third = Run::start(dir.path(), &clock, &receiver);
    third.pass(HOUR / 4);
    assert_eq!(count(), 1);
    third.pass(HOUR);
    assert_eq!((count(), third.documents), (2, 1));
    let summary = receiver.last();
    assert_eq!((&summary["share_before"], &summary["change"]), (&0.0.into(), &0.0.into()));
    assert_eq!(summary["obstacles"][1]["since_ms"], began_ms, "a restart keeps when an obstacle began");
    // Setting the clock back by half a day repeats none.
    third.pass(23 * HOUR);
    assert_eq!(count(), 3);
    clock.set_wall(clock.now_ns() - 12 * 3600 * 1_000_000_000);
    third.pass(HOUR);
    assert_eq!(count(), 3);
}

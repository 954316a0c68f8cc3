//! A receiver outside the bus that is down, refuses documents and recovers, and the account of what it must get.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Arc, Mutex};

use stiction_engine::config::Deliver;
use stiction_engine::short_hash;
use stictiond::daemon::sim_daemon::SimDaemon;
use stictiond::daemon::sink::deliver::{Failure, Item, MakeTarget, Target};

#[derive(Default)]
struct State {
    away: bool,
    /// Loop and identity of accepted documents, in order.
    got: Vec<(String, String)>,
}

/// The receiver; clones share it.
#[derive(Clone, Default)]
pub struct Receiver(Arc<Mutex<State>>);

/// Its fixed answer to a document: one in thirty is poison, one in thirty is refused at once.
fn verdict(id: &str) -> u8 {
    u8::from_str_radix(&short_hash(id.as_bytes())[..2], 16).unwrap() % 30
}

impl Target for Receiver {
    fn send(&mut self, item: &Item) -> Result<(), Failure> {
        let mut state = self.0.lock().unwrap();
        match verdict(&item.id) {
            _ if state.away => Err(Failure::Unanswered("away".to_owned())),
            0 => Err(Failure::Later("answers 500".to_owned(), None)),
            1 => Err(Failure::Refused("answers 422".to_owned())),
            _ => {
                state.got.push((item.loop_name.clone(), item.id.clone()));
                Ok(())
            }
        }
    }
}

impl Receiver {
    pub fn set_away(&self, away: bool) {
        self.0.lock().unwrap().away = away;
    }

    pub fn maker(&self) -> impl Fn(&Deliver) -> MakeTarget + use<> {
        let receiver = self.clone();
        move |_| {
            let receiver = receiver.clone();
            Box::new(move || Ok(Box::new(receiver.clone()) as Box<dyn Target>))
        }
    }
}

/// The published documents, and what happened to them.
#[derive(Default)]
pub struct Account {
    /// Identities by loop, in order of publication.
    published: BTreeMap<String, Vec<String>>,
    /// Published but perhaps not stored yet: a crash may lose them.
    unsure: BTreeSet<String>,
    /// Stored: they must reach the receiver or the dead-letter file, whatever happens.
    due: BTreeSet<String>,
    pub delivered: u64,
    pub dead: u64,
}

impl Account {
    pub fn published(&mut self, alarms: Vec<(String, String)>) {
        for (loop_name, id) in alarms {
            self.unsure.insert(id.clone());
            self.published.entry(loop_name).or_default().push(id);
        }
    }

    /// After the receivers' turn; with `stored`, the store has everything that waits.
    pub fn after_turn(&mut self, stored: bool) {
        if stored {
            self.due.append(&mut self.unsure);
        }
    }

    pub fn crashed(&mut self) {
        self.unsure.clear();
    }

    /// Checks that nothing is invented, that the order within each loop is kept, and that everything has arrived if nothing
    /// waits.
    pub fn compare(&mut self, receiver: &Receiver, stage: &SimDaemon, folder: &Path) {
        let got = receiver.0.lock().unwrap().got.clone();
        let mut last: BTreeMap<&str, usize> = BTreeMap::new();
        let mut seen = BTreeSet::new();
        for (loop_name, id) in &got {
            let place = self.published.get(loop_name).and_then(|ids| ids.iter().position(|known| known == id));
            let place = place.unwrap_or_else(|| panic!("{loop_name}: {id} was never published"));
            if seen.insert(id.as_str()) {
                let before = last.insert(loop_name, place);
                assert!(before.is_none_or(|before| before < place), "{loop_name}: {id} came out of order");
            }
        }
        let files = ["dead-letters.1.jsonl", "dead-letters.jsonl"];
        let text: String = files.iter().map(|f| std::fs::read_to_string(folder.join(f)).unwrap_or_default()).collect();
        let dead: BTreeSet<String> = text
            .lines()
            .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["id"].as_str().unwrap().to_owned())
            .collect();
        assert!(dead.iter().all(|id| verdict(id) < 2), "a good document was given up");
        assert_eq!(stage.metrics().delivery_dropped.get(), 0);
        (self.delivered, self.dead) = (seen.len() as u64, dead.len() as u64);
        if stage.undelivered() == 0 {
            let missing = self.due.iter().find(|id| !seen.contains(id.as_str()) && !dead.contains(*id));
            assert_eq!(missing, None, "it was in the store, and nobody got it");
        }
    }
}

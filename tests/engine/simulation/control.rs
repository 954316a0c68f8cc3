//! Requests from people and the system are handled however many samples wait.

use std::sync::{Arc, Mutex};

use stiction_engine::alarm::{AlarmAction, Command};
use stiction_engine::config::Config;
use stiction_files::disk::{Disk, SystemDisk};
use stictiond::daemon::sim_daemon::{SimDaemon, no_receiver};
use stictiond::runtime::clock::Clock;

#[test]
fn a_command_is_taken_and_answered_while_samples_fill_their_queue() {
    let dir = tempfile::tempdir().unwrap();
    let text = format!(
        "[site]\nprefix = \"p\"\n[input]\nqueue = 100\n[recording]\ndir = {:?}\n",
        dir.path().to_str().unwrap()
    );
    let (config, disk) = (Config::parse(&text).unwrap(), Arc::new(SystemDisk) as Arc<dyn Disk>);
    let mut stage = SimDaemon::start(config, &text, &Clock::standing(super::START_NS), &disk, no_receiver).unwrap();
    stage.deliver("p/A/op", b"1");
    stage.turn();
    // No single key may fill the queue, but many together may.
    for key in 0..300 {
        stage.deliver(&format!("p/L{key}/op"), b"1");
        stage.turn();
    }
    (0..300).for_each(|key| stage.deliver(&format!("p/L{key}/op"), b"1"));
    assert_eq!(stage.metrics().dropped_input.get(), 200, "the queue is full");
    let answers = Arc::new(Mutex::new(Vec::new()));
    for _ in 0..10 {
        let told = answers.clone();
        let command = Command { action: AlarmAction::OutOfService, by: Some("ann".into()), why: None, for_s: None };
        let answer = Box::new(move |answer: Result<_, String>| told.lock().unwrap().push(answer.is_ok()));
        assert!(stage.command("A", command, answer), "refused because samples wait");
    }
    stage.turn();
    assert!(stage.keep());
    assert_eq!(answers.lock().unwrap().len(), 10);
    assert_eq!(
        answers.lock().unwrap().iter().filter(|done| **done).count(),
        1,
        "the first is carried out, the others find it done"
    );
}

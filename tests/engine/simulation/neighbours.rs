//! Gap diagnoses with neighbours, offered by area or as the upstream loop: recorded, and replayed byte for byte.

use std::sync::{Arc, Mutex};

use serde_json::Value;
use stiction::core::gap::Serial;
use stiction::core::record::Record;
use stiction_engine::config::Config;
use stiction_engine::engine::GapRequest;
use stiction_files::disk::{Disk, SystemDisk};
use stiction_lab::plants::{Relation, disturbed, unrelated_loops};
use stictiond::daemon::gaps::Outcome;
use stictiond::daemon::sim_daemon::{SimDaemon, no_receiver};
use stictiond::runtime::clock::Clock;

use super::refill::{chains_replay_to_the_byte, replays_to_the_byte};
use super::repairs::{STICKS, Site, Work, wired};

const TARGET: &str = "TARGET";
const DRIVER: &str = "DRIVER";
const FAR: &str = "FAR";

/// Sends the samples of all loops in order of time.
pub fn play(stage: &mut SimDaemon, loops: &[(&str, &Record)]) {
    let mut samples: Vec<(i64, String, f64)> = Vec::new();
    for (name, record) in loops {
        for (k, (op, pv)) in record.op().iter().zip(&record.pv).enumerate() {
            let t_ns = super::START_NS + record.start_ns + (k as f64 * record.ts_s * 1e9) as i64;
            samples.push((t_ns, format!("p/{name}/op"), *op));
            samples.push((t_ns, format!("p/{name}/pv"), *pv));
        }
    }
    samples.sort_by(|a, b| (a.0, &a.1).cmp(&(b.0, &b.1)));
    for (t_ns, key, value) in samples {
        stage.deliver(&key, format!(r#"{{"t": {t_ns}, "v": {value:?}}}"#).as_bytes());
        stage.turn();
    }
}

#[test]
fn a_diagnosis_is_offered_the_loops_of_its_area_and_replays_to_the_byte() {
    let dir = tempfile::tempdir().unwrap();
    let place = |name: &str, area: &str| format!("[[loop]]\nname = \"{name}\"\narea = \"{area}\"\n");
    let text = format!(
        "[site]\nprefix = \"p\"\n[window]\nhop_s = 86400.0\n[gap]\nbudget_evaluations = 3000\n[recording]\ndir = {:?}\n{}{}{}",
        dir.path().to_str().unwrap(),
        place(TARGET, "unit 7"),
        place(DRIVER, "unit 7"),
        place(FAR, "unit 8"),
    );
    let (config, disk) = (Config::parse(&text).unwrap(), Arc::new(SystemDisk) as Arc<dyn Disk>);
    let mut stage = SimDaemon::start(config, &text, &Clock::standing(super::START_NS), &disk, no_receiver).unwrap();
    let case = disturbed("A", 3, 1, Relation::Acts);
    let far = unrelated_loops(3, 1, 1, &case.record, &case.periods_s).remove(0);
    play(&mut stage, &[(TARGET, &case.record), (DRIVER, &case.other), (FAR, &far)]);

    let answered = Arc::new(Mutex::new(None));
    let told = answered.clone();
    assert!(stage.ask_gap(TARGET, "ann", false, Box::new(move |answer| *told.lock().unwrap() = Some(answer))));
    stage.turn();
    let mut offered: Vec<String> = Vec::new();
    let diagnose = |request: &GapRequest| {
        offered.extend(request.neighbours.iter().map(|n| n.name.clone()));
        Outcome::Done(Box::new(request.compute(&Serial).unwrap()), None)
    };
    assert_eq!(stage.diagnose(diagnose), 1);
    assert_eq!(offered, [DRIVER], "only what is in the area");
    let document: Value = serde_json::from_slice(&answered.lock().unwrap().take().unwrap().unwrap()).unwrap();
    let compared = &document["neighbours"];
    assert_eq!((&compared["offered"], &compared["best"]), (&1.into(), &DRIVER.into()), "{compared}");
    assert_eq!(
        (&compared["acts"], &document["cause"]["id"]),
        (&DRIVER.into(), &"neighbour(DRIVER)".into()),
        "{document}"
    );
    let parts = document["budget"]["parts"].as_array().unwrap();
    assert!(parts.iter().any(|part| part["id"] == "neighbour(DRIVER)" && part["confirmed"] == true), "{parts:?}");
    stage.finish();
    drop(stage);
    assert_eq!(replays_to_the_byte(dir.path()), 4, "the diagnosis, and the estimates at the end");
}

#[test]
fn a_diagnosis_that_nobody_asked_for_is_offered_the_loop_upstream_and_names_it() {
    let dir = tempfile::tempdir().unwrap();
    let settings =
        format!("[gap]\nbudget_evaluations = 3000\n[[loop]]\nname = \"{TARGET}\"\nupstream = [\"{DRIVER}\"]\n");
    let loops = vec![wired(DRIVER, 18.0, None, 1), wired(TARGET, 10.0, Some((0, 0.8)), 2)];
    let mut site = Site::start(dir.path(), ["", &settings], loops);
    // The loop's own model is known before the upstream valve begins to stick.
    let plan: [Work; 2] = [(0, TARGET, STICKS), (7, DRIVER, STICKS)];
    let gaps: Vec<Value> = (0..12).flat_map(|hop| site.hop(hop, &plan).gaps).collect();
    let of_target: Vec<&Value> = gaps.iter().filter(|gap| gap["loop"] == TARGET).collect();
    let [gap] = of_target[..] else { panic!("{gaps:#?}") };
    assert_eq!((&gap["reason"], &gap["by"]), (&"fit_fell".into(), &Value::Null));
    assert_eq!(gap["neighbours"]["best"], DRIVER, "{gap}");
    assert_eq!(gap["cause"]["id"], format!("neighbour({DRIVER})"), "{}", gap["cause"]);
    site.stage.finish();
    drop(site);
    assert!(chains_replay_to_the_byte(dir.path()) > 10);
}

//! Days of a hundred loops under faults, from a seed. Queues, engine, schedule, recorder, store, restore, page, delivery, gap
//! diagnoses and retention are the daemon's; clock, disk, bus and receiver are controlled by the seed.
//!
//! `STICTIOND_SEED=N` runs one seed (a failure names its seed), `STICTIOND_SEEDS=N` that many, `STICTIOND_SIM_DAYS=N` for that
//! long.

mod control;
mod disk;
mod edits;
mod folder;
mod hostile;
mod leavers;
mod neighbours;
mod oracle;
mod plant;
mod pooled;
mod receiver;
mod refill;
mod repairs;
mod restarts;
mod scripted;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use disk::{FaultyDisk, Mode};
use folder::{Folder, RAW_DAYS, RESULTS_DAYS};
use oracle::{Asked, Oracle};
use plant::{Plant, STEP_NS, below, one_in};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use receiver::{Account, Receiver};
use scripted::scripted;
use stiction::core::gap::Serial;
use stiction_engine::alarm::Command;
use stiction_engine::codec::topic::{Kind, Leaf, Topic};
use stiction_engine::config::Config;
use stiction_engine::engine::{GapRequest, SkipReason};
use stiction_files::disk::Disk;
use stiction_files::{RecordingReader, log_topic};
use stictiond::daemon::gaps::Outcome;
use stictiond::daemon::sim_daemon::SimDaemon;
use stictiond::daemon::source::Message;
use stictiond::runtime::clock::Clock;

const PREFIX: &str = "plant/a";
const LOOPS: usize = 100;
const MAX_LOOPS: usize = 110;
const QUEUE: usize = 3000;
const QUEUE_BYTES: usize = 4_194_304;
const DAY_STEPS: i64 = 144;
/// A start that is not a whole hour, day or hop.
const START_NS: i64 = 1_700_000_123_000_000_000;

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok().and_then(|text| text.parse().ok())
}

/// Prints the seed if a run fails.
struct Named(u64);

impl Drop for Named {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let seed = self.0;
            eprintln!("\nseed {seed} failed; again: STICTIOND_SEED={seed} cargo test --test engine simulation\n");
        }
    }
}

/// Figures of a whole simulation, printed at its end.
#[derive(Debug, Default, Clone, PartialEq)]
struct Figures {
    messages: u64,
    samples: u64,
    dropped: u64,
    windows: u64,
    recorded: u64,
    lost: u64,
    ahead: u64,
    over_limit: u64,
    over_share: u64,
    restarts: u64,
    power_cuts: u64,
    disk_faults: u64,
    clock_jumps: u64,
    acknowledged: u64,
    refused: u64,
    not_stored: u64,
    alarms: u64,
    skipped: u64,
    delivered: u64,
    dead_letters: u64,
    receiver_faults: u64,
    gaps: u64,
    gaps_refused: u64,
    comparisons: u64,
    thinned: u64,
    removed: u64,
    digest: u64,
}

type Answers = Arc<Mutex<Vec<(Asked, Result<Vec<u8>, String>)>>>;

/// Steps between two checks of the recording folder.
const FOLDER_STEPS: i64 = 36;
/// Results of requested diagnoses.
type GapAnswers = Arc<Mutex<Vec<Result<Vec<u8>, String>>>>;

/// Computes one diagnosis in three; the others fail, since each takes as long as hours of the rest.
fn diagnosed(request: &GapRequest) -> Outcome {
    if (request.id.index() as u64 + request.number).is_multiple_of(3) {
        match request.compute(&Serial) {
            Ok(document) => return Outcome::Done(Box::new(document), None),
            Err(error) => return Outcome::Skipped(SkipReason::Failed, error.to_string()),
        }
    }
    Outcome::Skipped(SkipReason::Failed, "broke off".to_owned())
}

/// The counts expected of this run of the daemon.
#[derive(Default)]
struct Run {
    messages: u64,
    dropped: u64,
    samples_at_most: u64,
    waiting: (usize, usize),
    /// Waiting messages and bytes by flow, keys of known loops, and keys that may become known.
    flows: BTreeMap<String, (usize, usize)>,
    known: BTreeSet<String>,
    new_keys: Vec<String>,
    /// Requested diagnoses; those taken up, and those of them that were skipped.
    gap_asked: u64,
    gaps_done: u64,
    gaps_skipped: u64,
    /// Step since which the run has lasted and the clock was not set.
    calm_since: i64,
}

impl Run {
    /// The engine has taken everything, so keys of its loops are now known.
    fn taken(&mut self, stage: &SimDaemon) {
        self.waiting = (0, 0);
        self.flows.clear();
        let loop_of = |key: &str| key.strip_prefix(PREFIX)?.strip_prefix('/')?.split('/').next().map(str::to_owned);
        for key in std::mem::take(&mut self.new_keys) {
            let signal = key.ends_with("/op") || key.ends_with("/pv");
            if signal && loop_of(&key).is_some_and(|name| stage.engine().find(&name).is_some()) {
                self.known.insert(key);
            }
        }
    }
}

struct Simulation {
    seed: u64,
    random: ChaCha8Rng,
    config: Config,
    text: String,
    clock: Clock,
    disk: FaultyDisk,
    plant: Plant,
    oracle: Oracle,
    stage: SimDaemon,
    run: Run,
    answers: Answers,
    gap_answers: GapAnswers,
    receiver: Receiver,
    account: Account,
    folder: Folder,
    receiver_back: i64,
    disk_well_again: i64,
    worker_stalls: i64,
    step: i64,
    figures: Figures,
}

impl Simulation {
    fn new(seed: u64, dir: &Path) -> Self {
        let text = format!(
            "[site]\nprefix = \"{PREFIX}\"\n[input]\nmax_loops = {MAX_LOOPS}\nqueue = {QUEUE}\nqueue_bytes = {QUEUE_BYTES}\n\
             [window]\nhop_s = 43200.0\nmax_window_s = 172800.0\nmax_points = 128\nlateness_s = 1800.0\n\
             [alarm]\nraise = [2, 3]\ns_limit_op = 1.0\n[gap]\nenabled = false\nbudget_evaluations = 1000\n\
             [retention]\nraw_days = {RAW_DAYS}\nresults_days = {RESULTS_DAYS}\n\
             [[deliver]]\nname = \"cmms\"\nto = \"http://127.0.0.1:1\"\n\
             [recording]\ndir = {:?}\nmax_s = 86400.0\n",
            dir.to_str().unwrap()
        );
        let config = Config::parse(&text).unwrap();
        let clock = Clock::standing(START_NS);
        let (disk, receiver) = (FaultyDisk::new(seed, &clock), Receiver::default());
        let below = Arc::new(disk.clone()) as Arc<dyn Disk>;
        let stage = SimDaemon::start(config.clone(), &text, &clock, &below, receiver.maker()).unwrap();
        Self {
            seed,
            random: ChaCha8Rng::seed_from_u64(seed),
            config,
            text,
            clock,
            disk,
            plant: Plant::new(PREFIX, LOOPS),
            oracle: Oracle::default(),
            stage,
            run: Run::default(),
            answers: Answers::default(),
            gap_answers: GapAnswers::default(),
            receiver,
            account: Account::default(),
            folder: Folder::new(dir),
            receiver_back: 0,
            disk_well_again: 0,
            worker_stalls: 0,
            step: 0,
            figures: Figures::default(),
        }
    }

    fn chance(&mut self, n: u32) -> bool {
        one_in(&mut self.random, n)
    }

    /// Puts a message into the queue, and notes what must happen to it.
    fn deliver(&mut self, key: &str, payload: &[u8], samples: u64) {
        let bytes = size_of::<Message>() + key.len() + payload.len();
        let run = &mut self.run;
        let (length, held) = run.waiting;
        // The rule of shares, implemented independently: a key may hold four times what is free, all unknown keys together as
        // one.
        let flow = if run.known.contains(key) { key } else { "" };
        let of = run.flows.entry(flow.to_owned()).or_default();
        let room = QUEUE_BYTES.checked_sub(held + bytes);
        let fits = |room: usize| of.0 <= 4 * (QUEUE - length) && of.1 <= 4 * room;
        run.messages += 1;
        if length == QUEUE || !room.is_some_and(fits) {
            run.dropped += 1;
        } else {
            *of = (of.0 + 1, of.1 + bytes);
            run.waiting = (length + 1, held + bytes);
            run.samples_at_most += samples;
            run.new_keys.push(key.to_owned());
        }
        self.stage.deliver(key, payload);
    }

    fn step(&mut self, step: i64) {
        self.step = step;
        self.faults(step);
        for sent in self.plant.step(&mut self.random, step, START_NS) {
            self.deliver(&sent.key, &sent.payload, sent.samples);
        }
        if self.chance(200) {
            // A flood on one key, more than ten times its rate.
            let key = format!("{PREFIX}/{}/op", Plant::name(7));
            let size = if self.chance(2) { 3000 } else { 3 };
            let payload = format!("{}1{}", " ".repeat(size), " ".repeat(size));
            (0..2 * QUEUE).for_each(|_| self.deliver(&key, payload.as_bytes(), 1));
        }
        if self.chance(6) {
            self.ask();
        }
        assert!(self.stage.waiting().0 <= QUEUE_BYTES);
        self.stage.turn();
        self.run.taken(&self.stage);
        self.oracle.follow(self.stage.published());
        // Refusals come at once, and are judged by the current state.
        self.answered(true);
        let fits = if step < self.worker_stalls { 0 } else { 2 * LOOPS };
        let seed = self.seed;
        // One fit in three hundred fails.
        self.stage.work(fits, |name, r| (r.seq % 300 != 7).then(|| scripted(seed, name, r)));
        self.oracle.follow(self.stage.published());
        self.diagnose();
        if step % 64 == 0 && self.stage.compare() {
            self.figures.comparisons += 1;
        }
        self.clock.advance(Duration::from_nanos(STEP_NS as u64));
        self.stage.record();
        let stored = self.stage.keep();
        self.send_out();
        let alive = !self.disk.is_off();
        if stored && alive {
            self.oracle.stored();
        }
        self.answered(alive);
        assert!(self.oracle.asked.is_empty(), "without an answer: {:?}", self.oracle.asked);
        self.check(step);
        self.keep_folder(step);
        if !alive {
            self.end_life(true);
        } else if self.chance(150) {
            let power = self.chance(2);
            self.end_life(power);
        } else if self.chance(500) {
            self.restart_in_order();
        }
    }

    /// A person sometimes requests a diagnosis; waiting ones are run.
    fn diagnose(&mut self) {
        if self.chance(20) {
            let name = Plant::name(below(&mut self.random, LOOPS as u32) as usize);
            let answers = self.gap_answers.clone();
            let answer = Box::new(move |result| answers.lock().unwrap().push(result));
            self.run.gap_asked += u64::from(self.stage.ask_gap(&name, "ann", false, answer));
            self.stage.turn();
        }
        let mut skipped = 0;
        let done = self.stage.diagnose(|request| {
            let outcome = diagnosed(request);
            skipped += u64::from(matches!(outcome, Outcome::Skipped(..)));
            outcome
        });
        self.run.gaps_done += done as u64;
        self.run.gaps_skipped += skipped;
        self.oracle.follow(self.stage.published());
        let answers = std::mem::take(&mut *self.gap_answers.lock().unwrap());
        self.run.gap_asked -= answers.len() as u64;
        assert_eq!(self.run.gap_asked, 0, "everybody who asked is answered once");
        self.figures.gaps_refused += answers.iter().filter(|answer| answer.is_err()).count() as u64;
    }

    /// Lets the receiver outside the bus work.
    fn send_out(&mut self) {
        let stored = self.stage.send_out();
        self.account.published(std::mem::take(&mut self.oracle.alarms));
        self.account.after_turn(stored && !self.disk.is_off());
        if self.step % 16 == 0 {
            self.account.compare(&self.receiver, &self.stage, Path::new(&self.config.recording.dir));
        }
    }

    /// Lets the retention worker work.
    fn keep_folder(&mut self, step: i64) {
        if step % FOLDER_STEPS != 0 || self.disk.is_off() {
            return;
        }
        let before = self.folder.look();
        self.stage.keep_folder();
        // After a clock jump or a start, nothing is removed by age for a day.
        let calm = step - self.run.calm_since > DAY_STEPS + 2 * FOLDER_STEPS;
        self.folder.compare(&before, self.clock.now_ns(), calm);
    }

    fn faults(&mut self, step: i64) {
        if step >= self.receiver_back {
            self.receiver.set_away(false);
            if self.chance(200) {
                self.receiver.set_away(true);
                self.receiver_back = step + 1 + i64::from(below(&mut self.random, 60));
                self.figures.receiver_faults += 1;
            }
        }
        if step >= self.disk_well_again {
            self.disk.set(Mode::Well);
            if self.chance(250) {
                let mode = [Mode::Full, Mode::Broken, Mode::ReadOnly][below(&mut self.random, 3) as usize];
                self.disk.set(mode);
                self.disk_well_again = step + 1 + i64::from(below(&mut self.random, 20));
                self.figures.disk_faults += 1;
            }
        }
        if self.chance(300) {
            self.disk.cut_after(1 + u64::from(below(&mut self.random, 30)));
        }
        if self.chance(400) {
            let years = i64::from(below(&mut self.random, 21)) - 10;
            self.clock.set_wall(START_NS + step * STEP_NS + years * 365 * DAY_STEPS * STEP_NS);
            self.figures.clock_jumps += 1;
            self.run.calm_since = step;
        }
        if self.chance(300) || self.plant.has_racing_stamps() && self.chance(8) {
            self.worker_stalls = step + 30;
        }
    }

    /// Sends a person's command; at most one waits for each loop.
    fn ask(&mut self) {
        const ALL: [&str; 9] =
            ["ack", "ack", "ack", "shelve", "unshelve", "suppress", "unsuppress", "out_of_service", "in_service"];
        let index =
            if self.chance(2) { 10 * below(&mut self.random, 10) } else { below(&mut self.random, LOOPS as u32) };
        let loop_name = Plant::name(index as usize);
        let cmd = ALL[below(&mut self.random, 9) as usize];
        let for_s = [None, Some(0), Some(90_000), Some(400_000)][below(&mut self.random, 4) as usize];
        let asked = Asked { loop_name: loop_name.clone(), cmd, for_s };
        let command = Command { action: cmd.parse().unwrap(), by: Some("ann".into()), why: None, for_s };
        let (answers, about) = (self.answers.clone(), asked.clone());
        let answer = Box::new(move |result| answers.lock().unwrap().push((about, result)));
        if self.stage.command(&loop_name, command, answer) {
            self.oracle.asked.push(asked);
        }
    }

    /// Checks replies: the change is on disk, or the reply says that it is not. A daemon that was killed first did not reply.
    fn answered(&mut self, alive: bool) {
        for (asked, result) in std::mem::take(&mut *self.answers.lock().unwrap()) {
            match result {
                Ok(_) => self.figures.acknowledged += 1,
                Err(why) if why.contains("not stored") => {
                    assert!(!alive || self.disk.mode() != Mode::Well, "the disk is well, and yet: {why}");
                    self.figures.not_stored += 1;
                }
                Err(why) => {
                    self.oracle.refused(&asked, &why);
                    self.figures.refused += 1;
                }
            }
        }
    }

    fn check(&mut self, step: i64) {
        let m = self.stage.metrics();
        assert_eq!((m.messages.get(), m.dropped_input.get()), (self.run.messages, self.run.dropped), "step {step}");
        assert!(m.samples.get() <= self.run.samples_at_most, "step {step}");
        assert!(self.stage.engine().ids().len() <= MAX_LOOPS);
        // At most one state waits for each loop, plus notes about the recordings.
        assert!(self.stage.waiting().1 <= MAX_LOOPS + 300);
        // Everything handed to the recorder is on disk, counted as lost, or in the open chunk.
        let taken = m.samples.get() - m.over_rate.get() - m.stamps_ahead.get();
        let windows = 2 * m.estimates.get() + m.alarms.get() + m.fits_skipped.get();
        let gaps = self.run.gaps_done + self.stage.gaps_waiting() as u64 + m.gaps.get() + self.run.gaps_skipped;
        let plant = m.comparisons_due.get() + m.comparisons.get() + m.group_documents.get() + m.group_answers.get();
        let handed = taken + windows + 2 * m.commands.get() + gaps + plant;
        let kept = m.recorded.get() + m.recording_lost.get();
        assert_eq!(kept, handed, "step {step}: recorded {} and lost {}", m.recorded.get(), m.recording_lost.get());
        if step % 16 == 0 {
            self.oracle.compare(&self.stage);
            for queue in &self.stage.health().queues {
                assert!(queue.length <= queue.limit && (queue.limit_bytes == 0 || queue.bytes <= queue.limit_bytes));
            }
            self.oracle.compare_page(&self.stage, self.clock.now_ns());
        }
        let mut faults = self.stage.faults();
        // This fault concerns the real disk of the machine that runs the test.
        faults.retain(|fault| !fault.contains("nearly full"));
        let well = self.disk.mode() == Mode::Well && !self.disk.is_off();
        assert!(well || !faults.is_empty() || self.stage.metrics().samples.get() == 0, "a fault that nobody names");
    }

    fn sum_up(&mut self) {
        let (m, f) = (self.stage.metrics(), &mut self.figures);
        f.messages += m.messages.get();
        f.samples += m.samples.get();
        f.dropped += m.dropped_input.get();
        f.windows += m.windows.get();
        f.recorded += m.recorded.get();
        f.lost += m.recording_lost.get();
        f.ahead += m.stamps_ahead.get();
        f.over_limit += m.loops_over_limit.get();
        f.over_share += m.over_share.get();
        f.gaps += m.gaps.get();
    }

    /// Checks that the files of a run contain everything that it counted as recorded.
    fn look_into(&self, run_id: &str, recorded: u64) {
        if self.folder.has_touched(run_id) {
            return;
        }
        let mut found = 0;
        for entry in std::fs::read_dir(&self.config.recording.dir).unwrap().flatten() {
            if !entry.file_name().to_string_lossy().contains(run_id) {
                continue;
            }
            let mut reader = RecordingReader::open(&entry.path()).unwrap();
            while let Some(message) = reader.next_message().unwrap() {
                if message.topic() == log_topic(PREFIX) {
                    continue;
                }
                let topic = Topic::parse(Some(PREFIX), message.topic()).expect("a topic of ours");
                let at_open = topic.leaf == Leaf::Document(Kind::State)
                    && serde_json::from_slice::<serde_json::Value>(message.data).unwrap()["window_end_ns"].is_null();
                found += u64::from(!at_open);
            }
        }
        assert!(found >= recorded, "run {run_id} recorded {recorded} messages, {found} can be read");
    }

    /// Ends with kill -9 or a power cut, then starts again.
    fn end_life(&mut self, power: bool) {
        self.sum_up();
        self.figures.power_cuts += u64::from(power);
        let (run_id, recorded) = (self.stage.run_id().to_owned(), self.stage.metrics().recorded.get());
        self.disk.end(power);
        self.start();
        self.look_into(&run_id, recorded);
    }

    fn restart_in_order(&mut self) {
        let well = self.disk.mode() == Mode::Well;
        // Windows without a fit get their documents at the end.
        let published = self.stage.finish();
        self.oracle.follow(published.into_iter());
        self.account.published(std::mem::take(&mut self.oracle.alarms));
        self.sum_up();
        let (run_id, recorded) = (self.stage.run_id().to_owned(), self.stage.metrics().recorded.get());
        if well {
            self.oracle.stored();
        }
        self.disk.end(false);
        self.start();
        self.look_into(&run_id, recorded);
    }

    fn start(&mut self) {
        // The disk works when the machine is back; otherwise nothing could be compared.
        self.disk.set(Mode::Well);
        self.disk_well_again = 0;
        self.figures.restarts += 1;
        self.answers.lock().unwrap().clear();
        let disk = Arc::new(self.disk.clone()) as Arc<dyn Disk>;
        let receiver = self.receiver.maker();
        self.stage = SimDaemon::start(self.config.clone(), &self.text, &self.clock, &disk, receiver).unwrap();
        self.run = Run { calm_since: self.step, ..Run::default() };
        self.gap_answers.lock().unwrap().clear();
        self.account.crashed();
        self.oracle.restarted(&mut self.stage);
        assert!(!self.stage.faults().iter().any(|f| f.contains("cannot be stored")), "{:?}", self.stage.faults());
    }
}

fn simulate(seed: u64, days: i64) -> Figures {
    let _named = Named(seed);
    let dir = tempfile::tempdir().unwrap();
    let mut simulation = Simulation::new(seed, &dir.path().join("rec"));
    for step in 0..days * DAY_STEPS {
        simulation.step(step);
    }
    simulation.sum_up();
    let Simulation { figures, oracle, account, folder, .. } = simulation;
    Figures {
        alarms: oracle.raised,
        skipped: oracle.skipped,
        delivered: account.delivered,
        dead_letters: account.dead,
        thinned: folder.thinned,
        removed: folder.removed,
        digest: oracle.digest,
        ..figures
    }
}

#[test]
fn days_of_a_hundred_loops_under_faults() {
    let days = number("STICTIOND_SIM_DAYS").unwrap_or(7) as i64;
    let seeds: Vec<u64> = match (number("STICTIOND_SEED"), number("STICTIOND_SEEDS")) {
        (Some(seed), _) => vec![seed],
        (None, Some(n)) => (1..=n).collect(),
        (None, None) => vec![1],
    };
    for seed in seeds {
        let started = Instant::now();
        let figures = simulate(seed, days);
        println!("seed {seed}, {days} days in {:.1} s: {figures:?}", started.elapsed().as_secs_f64());
        // Check that the faults occurred: a simulation without events proves nothing.
        if days >= 7 && seed == 1 {
            assert!(figures.restarts > 2 && figures.power_cuts > 0 && figures.disk_faults > 0 && figures.alarms > 0);
            assert!(figures.acknowledged > 5 && figures.dropped > 0 && figures.skipped > 0 && figures.lost > 0);
            assert!(figures.ahead > 0 && figures.over_limit > 0 && figures.over_share > 0, "limits were met");
            assert!(figures.recorded > 4 * figures.lost, "most of it is recorded all the same");
            assert!(figures.delivered > 25 && figures.dead_letters > 0 && figures.receiver_faults > 0);
            assert!(figures.comparisons > 0 && figures.gaps_refused > 3 && figures.thinned > 1 && figures.removed > 1);
        }
        if days >= 30 && seed == 1 {
            assert!(figures.gaps > 2 && figures.power_cuts > 2 && figures.delivered > 100 && figures.dead_letters > 2);
        }
    }
}

#[test]
fn a_seed_gives_the_same_run_again_to_the_byte() {
    let run = || simulate(7, 3);
    assert_eq!(run(), run());
}

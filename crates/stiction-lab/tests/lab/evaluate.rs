//! `stiction-lab evaluate`: its counts, and its messages about files and labels that it cannot use.

use std::fs;
use std::process::Output;

use super::{lab, text};

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    fn write(&self, name: &str, text: impl AsRef<[u8]>) -> String {
        fs::write(self.0.path().join(name), text).unwrap();
        self.path(name)
    }
}

fn expect(code: i32, arguments: &[&str]) -> Output {
    let output = lab(arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", text(&output.stderr));
    output
}

fn stdout(output: &Output) -> String {
    text(&output.stdout)
}

fn stderr(output: &Output) -> String {
    text(&output.stderr)
}

/// A triangle in OP and a square in PV (the shapes of a sticking valve), or two sines.
fn wave(sticking: bool) -> String {
    let row = |k: i32| {
        let t = f64::from(k) / 60.0;
        let (t, turn) = (t.fract(), 2.0 * core::f64::consts::PI * t);
        let triangle = if t < 0.5 { 4.0 * t - 1.0 } else { 3.0 - 4.0 * t };
        let square = if (0.1..0.6).contains(&t) { 1.0 } else { -1.0 };
        let noise = 1e-3 * f64::from(k * k % 31);
        let (op, pv) = if sticking { (triangle, square) } else { (turn.sin(), -turn.sin()) };
        format!("{k},{},{}\n", 50.0 + 3.0 * op, 20.0 + pv + noise)
    };
    format!("t,op,pv\n{}", (0..600).map(row).collect::<String>())
}

/// A table of a slow wave; `time` gives the seconds for each row.
fn slow_wave(time: impl Fn(usize) -> usize) -> String {
    let row = |k: usize| {
        let phase = k as f64 / 20.0;
        format!("{},{:.4},{:.4}\n", 1_700_000_000 + time(k), 50.0 + 5.0 * phase.sin(), 9.0 + phase.cos())
    };
    (0..600).fold("t,op,pv\n".to_owned(), |text, k| text + &row(k))
}

#[test]
fn evaluate_counts_records_data_and_valves() {
    let folder = Folder::new();
    for (name, sticking) in [("A_01", true), ("A_02", true), ("B", false), ("C", false)] {
        folder.write(&format!("{name}.csv"), wave(sticking));
    }
    let index = folder.write(
        "INDEX.csv",
        "file,loop,valve,label,same_data_group\n\
         A_01.csv,A_01,,stiction,\nA_02.csv,A_02,,no_stiction,\n\
         B.csv,B,,tuning,D1\nC.csv,C,B,disturbance,D1\nC.csv,C,,unknown,\ngone.csv,G,,stiction,\n",
    );
    let text = stdout(&expect(0, &["evaluate", &index, "--format", "json"]));
    let lines: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let (cases, last) = lines.split_at(lines.len() - 1);
    assert_eq!(cases.len(), 6);
    assert_eq!(
        (&cases[0]["valve"], &cases[1]["valve"], &cases[3]["valve"]),
        (&"/A".into(), &"/A".into(), &"/B".into())
    );
    assert!(cases[5]["error"].is_string());
    let last = &last[0];
    assert_eq!((&last["all"]["total"], &last["all"]["errors"]), (&5.into(), &1.into()));
    assert_eq!((&last["distinct"]["all"]["total"], &last["valves"]["all"]["total"]), (&4.into(), &3.into()));
    let interval = &last["all"]["interval"];
    assert!(interval[0].as_f64().unwrap() < interval[1].as_f64().unwrap());
    assert_eq!(last["confusion"]["unknown"].as_object().unwrap().len(), 1);
    assert!(last["brier"].as_f64().is_some_and(|b| (0.0..=1.0).contains(&b)));
    let counted: u64 = last["reliability"].as_array().unwrap().iter().map(|b| b["count"].as_u64().unwrap()).sum();
    assert_eq!(counted, 4);
    // The contributions of the indicators must add up to the calibrated probability.
    for case in &cases[..5] {
        let said: f64 =
            case["indicators"].as_array().unwrap().iter().map(|w| w["contribution"].as_f64().unwrap()).sum();
        let logit = case["explanation"]["base"].as_f64().unwrap() + said;
        let p = 1.0 / (1.0 + (-logit).exp());
        assert!((p - case["p_calibrated"].as_f64().unwrap()).abs() < 1e-9, "{case}");
    }
    let text = stdout(&expect(0, &["evaluate", &index]));
    for part in ["every valve counted once", "verdicts by label", "reliability", "gone.csv"] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn evaluate_judges_simulated_loops_and_compares_methods() {
    let folder = Folder::new();
    folder.write("A_01.csv", wave(true));
    folder.write("B.csv", wave(false));
    let index = folder.write("INDEX.csv", "file,label\nA_01.csv,stiction\nB.csv,tuning\ngone.csv,tuning\n");
    let simulated = stdout(&expect(0, &["evaluate", "--simulated", "4", "--seed", "5"]));
    for part in ["4 simulated loops from seed 5", "TPR, p >= 0.5", "answer rate"] {
        assert!(simulated.contains(part), "{part}: {simulated}");
    }
    let json = stdout(&expect(0, &["evaluate", "--simulated", "4", "--seed", "5", "--format", "json"]));
    let lines: Vec<serde_json::Value> = json.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let (document, cases) = lines.split_last().unwrap();
    assert_eq!(cases.iter().filter(|case| case["sticks"] == true).count(), 2);
    for decision in document["decisions"].as_array().unwrap() {
        assert_eq!((&decision["sticking"], &decision["healthy"]), (&2.into(), &2.into()), "{document}");
    }
    let methods = stdout(&expect(0, &["evaluate", &index, "--simulated", "4", "--methods", "--format", "json"]));
    let sets: Vec<serde_json::Value> = methods.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((&sets[0]["thresholds"], &sets[1]["thresholds"]), (&"published".into(), &"chosen".into()));
    for set in &sets {
        for method in set["methods"].as_array().unwrap() {
            let total = |of: &str| method[of].as_object().unwrap().values().map(|n| n.as_f64().unwrap()).sum::<f64>();
            assert_eq!((total("recordings"), total("simulated")), (2.0, 4.0), "{method}");
        }
    }
    // OP is a triangle in one recording, a sinusoid in the other.
    let curve_fit = &sets[0]["methods"][3]["recordings"];
    assert_eq!((&curve_fit["found"], &curve_fit["cleared"]), (&1.0.into(), &1.0.into()), "{curve_fit}");
    let text = stdout(&expect(0, &["evaluate", &index, "--methods"]));
    assert!(text.contains("Yamashita") && text.contains("shipped classifier"), "{text}");
    let alarms = stdout(&expect(0, &["evaluate", "--simulated", "2", "--alarms"]));
    assert!(alarms.contains("3 of 4 windows") && alarms.contains("10 %"), "{alarms}");
    expect(2, &["evaluate"]);
    expect(2, &["evaluate", "--simulated", "0"]);
}

#[test]
fn an_index_of_which_no_file_can_be_read_fails_and_an_unknown_label_is_said() {
    let folder = Folder::new();
    folder.write("a.csv", slow_wave(|k| k));
    let index = folder.write("index.csv", "file,label\na.csv,sticktion\nb.csv,stiction\n");
    let said = stderr(&expect(0, &["evaluate", &index]));
    assert!(said.contains("label \"sticktion\" (1 of 2 recordings) is not scored"), "{said}");
    let index = folder.write("none.csv", "file,label\nb.csv,stiction\n");
    assert!(stderr(&expect(1, &["evaluate", &index])).contains("no file of the index can be read"));
    assert!(stderr(&expect(1, &["evaluate", &folder.path("")])).contains(&folder.path("")));
}

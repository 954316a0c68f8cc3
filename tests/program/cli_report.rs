//! `analyze --report` run as a program: pages and sheets, refusals, and what remains on stdout.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::fs;
use std::process::{Command, Output};

fn analyze(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_stictiond")).arg("analyze").args(arguments).output().unwrap()
}

#[test]
fn a_page_and_a_sheet_are_written_and_never_overwritten_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let section = ["recordings/sticking.mcap", "--samples", "1,400", "--valve", "he", "--format", "json"];
    let (page, sheet) = (path("out.html"), path("out.svg"));

    let output = analyze(&[&section[..], &["--op-range", "0,100", "--report", &page]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    // stdout contains only documents.
    let documents = String::from_utf8(output.stdout).unwrap();
    assert!(documents.lines().count() == 1 && documents.starts_with('{'), "{documents}");
    let html = fs::read_to_string(&page).unwrap();
    for part in [
        "FIC101",
        "% of travel",
        "Bump test",
        "Error map, He's law, order 1",
        "Error map, He's law, order 2",
        "Histogram of fd",
    ] {
        assert!(html.contains(part), "{part}");
    }
    for part in ["Loop diagram", "Phase plot, shifted", "Decision chart", "Indicators", "stictiond analyze recordings/"]
    {
        assert!(html.contains(part), "{part}");
    }
    assert!(!html.contains("http://") && !html.contains("https://") && !html.contains("NaN"));
    assert!(html.len() < 1_000_000, "{} bytes", html.len());

    assert!(!html.contains("before downsampling"));
    let both = path("both.html");
    let halved = ["recordings/sticking.mcap", "--samples", "1,800", "--valve", "he", "--downsample", "2"];
    assert_eq!(analyze(&[&halved[..], &["--report", &both]].concat()).status.code(), Some(0));
    let text = fs::read_to_string(&both).unwrap();
    for part in ["Trends before downsampling", "Phase plot before downsampling", "As recorded: 800 samples of 1 s"] {
        assert!(text.contains(part), "{part}");
    }

    let again = analyze(&[&section[..], &["--report", &page]].concat());
    assert_eq!(again.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&again.stderr).contains("--force"));
    assert_eq!(fs::read_to_string(&page).unwrap(), html, "a refused report must leave the old one alone");

    let output = analyze(&[&section[..], &["--report", &sheet]].concat());
    assert_eq!(output.status.code(), Some(0));
    let svg = fs::read_to_string(&sheet).unwrap();
    assert!(svg.starts_with("<svg xmlns=") && svg.trim_end().ends_with("</svg>"));
    assert_eq!(svg.matches("<svg").count(), svg.matches("</svg>").count());

    let wrong = analyze(&[&section[..], &["--report", &path("out.pdf")]].concat());
    assert_eq!(wrong.status.code(), Some(2));
    assert!(!folder.path().join("out.pdf").exists());
}

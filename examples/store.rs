//! Files in the library: a compact store is written, read back and its loops assessed.
//!
//! `cargo run --example store`

use std::error::Error;
use std::fs::File;

use stiction::{AssessParams, assess};
use stiction_engine::analysis::{Cut, Points, Section};
use stiction_engine::config::Config;
use stiction_files::compact::{CompactLoop, write};
use stiction_files::load_samples;

fn main() -> Result<(), Box<dyn Error>> {
    let samples = load_samples("recordings/sticking.mcap".as_ref())?.loops.remove(0).samples;
    let one = CompactLoop::from_samples("FIC101", &samples, None)?;
    let path = std::env::temp_dir().join("stictiond-example.mat");
    write(&mut File::create(&path)?, &[one], true)?;

    // The same call reads tables, recordings and stores.
    let loaded = load_samples(&path)?;
    for one in &loaded.loops {
        let points = Points::of(&one.name, &one.samples, &Config::with_prefix("plant"));
        let cut = Cut { downsample: Some(2.0), ..Cut::default() };
        let most = points.settings.window.max_points;
        let (record, taken, _) = cut.record(&points, Section::Samples(50, 500), most)?;
        let found = assess(&record, &AssessParams { always_fit: true, ..AssessParams::default() });
        println!("{} {:?}: {} s {:?}", one.name, taken.section, found.verdict.name(), found.s);
    }
    std::fs::remove_file(path)?;
    Ok(())
}

//! Properties that the generator guarantees.

use super::enter::{Made, Scale};
use super::generator::{self, Order};
use super::plant::{Drive, Plant, ProcessSpec};
use super::valve::{Packing, ValveSpec};
use super::*;
use stiction::core::signal::stats::{median, noise_sd, std_dev};
use stiction::core::sim::controller::{Action, PidSettings};

fn order(kinds: Vec<Kind>, seed: u64) -> Order {
    let setpoint_moves = seed.is_multiple_of(2);
    Order {
        stream: "challenge/test".to_owned(),
        seed,
        kinds,
        size: 2,
        setpoint_moves,
        transient: seed % 4 < 2,
        mv: false,
        periods: None,
    }
}

#[test]
fn equal_seeds_give_equal_bits_and_splits_have_nothing_in_common() {
    let bits = |seed, split, index: usize| -> Vec<u64> {
        let dealt = Deck::new(seed, split, 1).deal(index).unwrap();
        dealt.record.pv.iter().chain(&dealt.record.op_path).map(|x| x.to_bits()).collect()
    };
    assert_eq!(bits(1, Split::A, 3), bits(1, Split::A, 3));
    assert_ne!(bits(1, Split::A, 3), bits(1, Split::B, 3));
    assert_ne!(bits(1, Split::A, 3), bits(3, Split::A, 3));
}

#[test]
fn a_deck_has_what_the_table_says_and_its_order_tells_nothing() {
    let deck = Deck::new(7, Split::A, 4);
    let count = |wanted: usize| deck.orders.iter().filter(|o| o.kinds.len() == wanted).count();
    assert_eq!((count(0), count(1), count(2)), (40, 132, 15));
    for kind in Kind::CATALOGUE.into_iter().chain([Kind::FILTER]) {
        let its: Vec<&Order> = deck.orders.iter().filter(|o| o.kinds == [kind]).collect();
        assert_eq!(its.iter().filter(|o| o.setpoint_moves).count(), 2, "{kind:?}");
        assert_eq!(its.iter().filter(|o| o.transient).count(), 2, "{kind:?}");
        assert!((0..3).all(|size| its.iter().any(|o| o.size == size)), "{kind:?}");
    }
    let with_mv = deck.orders.iter().filter(|o| o.mv).count();
    assert!((20..75).contains(&with_mv), "{with_mv}");
    // Neighbours in the deck are no more alike than chance: the kinds are shuffled.
    let alike = deck.orders.windows(2).filter(|w| w[0].kinds == w[1].kinds).count();
    assert!(alike < 30, "{alike}");
}

/// A loop in which every effect is possible, and can be left at size 0.
fn loop_and_scale() -> (Made, Scale) {
    let packing = Packing { fs: 3.0, fc: 1.2, vs: 0.6, fv: 0.05 };
    let controller = PidSettings {
        kc: 0.5,
        ti_s: 22.0,
        td_s: 0.0,
        action: Action::Reverse,
        op_min: 0.0,
        op_max: 100.0,
        op_resolution: 0.0,
    };
    let plant = Plant {
        valve: ValveSpec::plain(packing),
        process: ProcessSpec::plain(1.5, 25.0, 8.4),
        controller,
        rest_op: 50.0,
        rest_pv: 80.0,
        strain: 0.7,
        retuned_at: 1.0,
        retuned: 1.0,
        pv_filter: 0.0,
        neighbour: None,
        seed: 5,
    };
    let mut drive = Drive::none(900);
    drive.sp[30..].fill(5.0);
    let scale = Scale { pv_mean: 85.0, pv_sd: 2.0, stem: [48.0, 56.0], jump: 1.5, period: 110.0, scans: 900, from: 0 };
    (Made::new(plant, drive), scale)
}

#[test]
fn an_effect_of_size_nothing_is_no_effect() {
    let (none, scale) = loop_and_scale();
    let plain = none.plant.run(&none.drive);
    for kind in Kind::CATALOGUE.into_iter().chain([Kind::FILTER]).chain(Kind::FOREIGN).chain([Kind::OF_BUDGET]) {
        let mut made = none.clone();
        made.enter(kind, 0.0, &scale, &mut Draw::new(3, "neutral"));
        let run = made.plant.run(&made.drive);
        assert_eq!(run.pv, plain.pv, "{kind:?}");
        assert!(made.artefacts.is_empty() && made.jitter == 0.0, "{kind:?}");
        let mut large = none.clone();
        large.enter(kind, 1.0, &scale, &mut Draw::new(3, "large"));
        let other = large.plant.run(&large.drive);
        let differs = other.pv != plain.pv || !large.artefacts.is_empty() || large.jitter > 0.0;
        assert!(differs, "{kind:?}");
    }
}

#[test]
fn effects_show_in_most_cases_and_loops_without_one_are_as_quiet_as_their_noise() {
    let mut shown = 0;
    let all: Vec<Kind> = Kind::CATALOGUE.into_iter().chain(Kind::FOREIGN).collect();
    for (at, kind) in all.iter().enumerate() {
        let case = generator::case(&order(vec![*kind], at as u64));
        shown += usize::from(case.base_rmse > 1.2 * case.noise_sd);
    }
    assert!(10 * shown >= 8 * all.len(), "{shown} of {}", all.len());
    let left: Vec<f64> = (0..10)
        .map(|seed| {
            let case = generator::case(&order(vec![], seed));
            case.oracle_rmse / case.noise_sd
        })
        .collect();
    assert!(median(&left) < 1.1, "{left:?}");
}

#[test]
fn the_noise_is_what_the_truth_says() {
    let case = generator::case(&order(vec![], 4));
    assert!((0.8..1.3).contains(&(noise_sd(&case.pv) / case.noise_sd)));
    assert!((case.noise_sd / case.pv_sd) < 0.11 && std_dev(&case.pv) > 0.8 * case.pv_sd);
}

#[test]
fn a_tampered_truth_is_refused() {
    let deck = Deck::new(2, Split::B, 1);
    let truth = deck.truth(vec![deck.deal(0).unwrap().truth]);
    let bytes = truth.to_bytes().unwrap();
    let sealed = seal(&bytes);
    assert_eq!(Truth::open(&bytes, &sealed).unwrap(), truth);
    let mut changed = bytes.clone();
    let at = changed.iter().position(|b| *b == b'1').unwrap();
    changed[at] = b'2';
    let error = Truth::open(&changed, &sealed).unwrap_err();
    assert!(error.to_string().contains(&sealed) && matches!(error, Tampered::Digest { .. }));
    assert!(Truth::open(&bytes, "").is_err());
}

#[test]
fn a_recording_shows_no_more_than_a_plant_would() {
    let deck = Deck::new(11, Split::A, 1);
    for index in 0..4 {
        let dealt = deck.deal(index).unwrap();
        assert_eq!(dealt.name, format!("loop-{:04}", index + 1));
        assert_eq!(dealt.record.mv.is_some(), dealt.truth.mv);
        assert_eq!((dealt.record.start_ns, dealt.record.sp.is_some()), (0, true));
    }
}

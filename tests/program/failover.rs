//! Two redundant gateways, as seen from the bus and from the recording.

use zenoh::Wait;
use zenoh::qos::CongestionControl;

use crate::live::{Daemon, files, ok, wait_for};

const SETTINGS: &str =
    "[input]\nmax_rate_hz = 0.0\n[window]\nhop_s = 60.0\n[recording]\nflush_s = 0.1\n[[bundle]]\nkey = \"gw/**\"\n";

#[test]
fn a_gateway_that_falls_silent_is_followed_by_the_next_one_and_two_live_ones_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), SETTINGS);
    let bus = daemon.session();
    let send = |gateway: &str, k: i64| {
        let (t_ns, value) = ((1_700_000_000 + k) * 1_000_000_000, 50 + 9 * (k / 25 % 2) + k % 3);
        let payload = format!("{{\"t\":{t_ns},\"FIC1.OP\":{value},\"FIC1.PV\":{value}}}");
        let put = bus.put(format!("gw/{gateway}"), payload).congestion_control(CongestionControl::Block);
        put.wait().unwrap();
    };
    let names_both = |part: &str| {
        let names = |fault: &String| fault.contains(part) && fault.contains("gw/a#") && fault.contains("gw/b#");
        daemon.faults().iter().any(names)
    };
    (0..600).for_each(|k| send("a", k));
    wait_for("the first gateway's samples", || (daemon.counter("samples") == 1200).then_some(()));
    assert_eq!((daemon.counter("second_source"), daemon.faults()), (0, vec![]));
    // The first one stops. The first five seconds of the second one are ignored, until this is certain.
    (600..1800).for_each(|k| send("b", k));
    wait_for("the second gateway's samples", || (daemon.counter("samples") == 3590).then_some(()));
    assert_eq!((daemon.counter("second_source"), daemon.counter("source_changes")), (10, 1));
    wait_for("the change among the faults", || names_both("is silent, now taken from").then_some(()));
    daemon.wait_for_estimates(20);
    // The first one comes back: it is ignored, and both are reported.
    for k in 1800..1900 {
        send("b", k);
        send("a", k);
    }
    wait_for("what came after it", || (daemon.counter("samples") == 3790).then_some(()));
    wait_for("all of the first gateway's", || (daemon.counter("second_source") == 210).then_some(()));
    wait_for("two sources among the faults", || names_both("comes from two sources at once").then_some(()));
    assert_eq!(daemon.counter("source_changes"), 1);
    bus.close().wait().unwrap();
    let recordings = files(&daemon.stop());
    ok(&["replay", recordings.last().unwrap().to_str().unwrap(), "--verify"]);
}

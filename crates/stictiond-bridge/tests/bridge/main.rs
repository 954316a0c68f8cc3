//! The program at its process boundary.
#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::process::{Command, Output};

fn bridge(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_stictiond-bridge")).args(arguments).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

#[test]
fn a_wrong_command_line_is_refused_with_the_argument_that_is_wrong() {
    for (arguments, part) in [
        (&["mqtt", "--from", "mqtt://b"][..], "--topic"),
        (&["mqtt", "--from", "http://b", "--topic", "a/#"], "http://b"),
        (&["mqtt", "--from", "mqtt://b", "--topic", "a/#", "--map", "no-key"], "no-key"),
        (&["mqtts"], "mqtts"),
    ] {
        let output = bridge(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(said(&output).contains(part) && output.stdout.is_empty(), "{arguments:?}: {}", said(&output));
    }
}

#[test]
fn a_secret_that_cannot_be_read_fails_before_anything_is_connected() {
    let text = "mqtt --from mqtt://localhost:1 --topic a/# --connect tcp/localhost:1 --prefix p --user u --secret-file /nowhere/pw";
    let output = bridge(&text.split(' ').collect::<Vec<_>>());
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains("/nowhere/pw"), "{}", said(&output));
}

#[test]
fn opc_ua_is_there_or_says_how_it_is_had() {
    for command in ["opcua", "discover"] {
        let output = bridge(&[command, "--help"]);
        let has = output.status.success();
        assert!(
            has == cfg!(feature = "opcua") && (has || said(&output).contains("--features opcua")),
            "{}",
            said(&output)
        );
    }
}

//! Alarms once more, as log messages that viewers show in their log panel. They follow from the recorded alarms: no reader and
//! no replay takes them for input.

use serde_json::{Value, json};
use stiction_engine::codec::topic;

/// Name of the messages' schema, by which viewers recognise them.
pub const LOG_SCHEMA: &str = "foxglove.Log";

/// Levels of that schema.
const INFO: u8 = 2;
const WARNING: u8 = 3;
const ERROR: u8 = 4;

/// Topic of a site's log messages.
#[must_use]
pub fn log_topic(prefix: &str) -> String {
    topic::plane(prefix, &format!("{}/log", topic::PLANT))
}

/// The schema of the messages.
pub(super) fn schema() -> Value {
    let time = json!({"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}});
    json!({
        "title": LOG_SCHEMA,
        "type": "object",
        "properties": {
            "timestamp": time,
            "level": {"type": "integer"},
            "message": {"type": "string"},
            "name": {"type": "string"},
            "file": {"type": "string"},
            "line": {"type": "integer"},
        },
    })
}

/// The log message of an alarm's document; none where it is no such document.
#[must_use]
pub fn log_message(alarm: &[u8]) -> Option<Vec<u8>> {
    let alarm: Value = serde_json::from_slice(alarm).ok()?;
    let text = |field: &str| alarm[field].as_str();
    let at_ns = alarm["changed_ns"].as_i64()?;
    let (second, part) = (at_ns.div_euclid(1_000_000_000), at_ns.rem_euclid(1_000_000_000));
    let level = match (alarm["active"].as_bool()?, text("state")?) {
        (true, "unack") => ERROR,
        (true, _) => WARNING,
        (false, _) => INFO,
    };
    let by = text("by").map(|by| format!(" by {by}")).unwrap_or_default();
    let event = text("event")?.replace('_', " ");
    let message = format!("stiction alarm {event}{by}: {}", text("detail")?);
    let log = json!({
        "timestamp": {"sec": second, "nsec": part},
        "level": level,
        "message": message,
        "name": text("loop")?,
        "file": "",
        "line": 0,
    });
    serde_json::to_vec(&log).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_level_follows_the_state_and_the_message_is_one_sentence() {
        let alarm = |active: bool, state: &str, event: &str, by: Value| {
            let alarm = json!({
                "loop": "FIC101", "changed_ns": 5_000_000_007_i64, "active": active, "state": state, "event": event,
                "by": by, "detail": "the valve sticks",
            });
            serde_json::from_slice::<Value>(&log_message(alarm.to_string().as_bytes()).unwrap()).unwrap()
        };
        let raised = alarm(true, "unack", "raised", Value::Null);
        assert_eq!((&raised["level"], &raised["name"]), (&4.into(), &"FIC101".into()));
        assert_eq!(raised["message"], "stiction alarm raised: the valve sticks");
        assert_eq!(raised["timestamp"], json!({"sec": 5, "nsec": 7}));
        let shelved = alarm(true, "shelved", "out_of_service", "ann".into());
        assert_eq!(
            (&shelved["level"], &shelved["message"]),
            (&3.into(), &"stiction alarm out of service by ann: the valve sticks".into())
        );
        assert_eq!(alarm(false, "normal", "cleared", Value::Null)["level"], 2);
        assert_eq!(log_message(b"{}"), None);
    }
}

//! AsyncAPI 3.0 of what the daemon publishes, with the schemas of its documents.

use serde_json::{Map, Value, json};

use crate::daemon::documents::schemas;
use stiction::core::VERSION;
use stiction::core::verdict::ESTIMATE_SCHEMA;
use stiction_engine::alarm::ALARM_SCHEMA;
use stiction_engine::codec::topic::{
    DAEMON_HEALTH_SCHEMA, DATA_HEALTH_SCHEMA, Kind, LOOP_HEALTH_SCHEMA, PLANT, plane, result,
};

/// A channel: its name, address and document, and when the daemon sends.
type Channel = (&'static str, String, &'static str, &'static str);

fn channels() -> [Channel; 7] {
    let of_loop = |kind| result("{prefix}", "{loop}", kind);
    let group = result("{prefix}", &format!("{PLANT}/{{loop}}"), Kind::Group);
    let of_daemon = |kind: Kind| plane("{prefix}", &format!("@daemon/{{id}}/{}", kind.name()));
    let gap = "Where a loop departs from its model, or a person asks with ?run;by=NAME.";
    let alarm = "On every change of state; after a restart, where the alarm is not at rest.";
    [
        ("estimate", of_loop(Kind::Estimate), ESTIMATE_SCHEMA, "Once a window, in the order of the windows."),
        ("alarm", of_loop(Kind::Alarm), ALARM_SCHEMA, alarm),
        ("gap", of_loop(Kind::Gap), Kind::Gap.schema(), gap),
        ("loopHealth", of_loop(Kind::Health), LOOP_HEALTH_SCHEMA, "Once a minute."),
        (
            "group",
            group,
            Kind::Group.schema(),
            "At every comparison of the loops, under the first of the group's loops.",
        ),
        ("daemonHealth", of_daemon(Kind::Health), DAEMON_HEALTH_SCHEMA, "Every 5 s."),
        ("dataHealth", of_daemon(Kind::DataHealth), DATA_HEALTH_SCHEMA, "Once a day, or as [summary] says."),
    ]
}

/// The description: every channel, and every document with its schema.
#[must_use]
pub fn document() -> Value {
    let (mut listed, mut operations) = (Map::new(), Map::new());
    for (name, address, schema, when) in channels() {
        let parameters: Map<String, Value> = ["prefix", "loop", "id"]
            .into_iter()
            .filter(|parameter| address.contains(&format!("{{{parameter}}}")))
            .map(|parameter| (parameter.to_owned(), json!({"$ref": format!("#/components/parameters/{parameter}")})))
            .collect();
        let message = json!({ schema: {"$ref": format!("#/components/messages/{schema}")} });
        let channel = json!({"address": address, "summary": when, "messages": message, "parameters": parameters});
        let operation = json!({"action": "send", "channel": {"$ref": format!("#/channels/{name}")}, "summary": when});
        listed.insert(name.to_owned(), channel);
        operations.insert(format!("send.{name}"), operation);
    }
    let messages: Map<String, Value> = schemas()
        .into_iter()
        .map(|(name, schema)| {
            let payload = json!({"schemaFormat": "application/schema+json;version=draft-2020-12", "schema": schema});
            (name.to_owned(), json!({"name": name, "contentType": "application/json", "payload": payload}))
        })
        .collect();
    json!({
        "asyncapi": "3.0.0",
        "info": {
            "title": "stictiond",
            "version": VERSION,
            "description": "What the daemon publishes over Zenoh. A key is a channel's address; every key also answers queries \
                            with its last document. No wildcard of the plant matches the chunk `@stiction`. The v1 in a key is \
                            the keys' version; a document's own version is in its field `schema`.",
            "license": { "name": "MIT OR Apache-2.0" },
        },
        "defaultContentType": "application/json",
        "servers": { "zenoh": {
            "host": "127.0.0.1:7447",
            "protocol": "zenoh",
            "description": "A Zenoh router or peer: [zenoh] listen and connect.",
        } },
        "channels": listed,
        "operations": operations,
        "components": {
            "messages": messages,
            "parameters": {
                "prefix": { "description": "[site] prefix; may have several chunks." },
                "loop": { "description": "The loop's name; may have several chunks." },
                "id": { "description": "The daemon's id." },
            },
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction_engine::codec::topic::schema_of;

    #[test]
    fn every_document_has_a_channel_and_every_reference_leads_to_something() {
        let whole = document();
        let mut sent: Vec<&str> = channels().iter().map(|(_, _, schema, _)| *schema).collect();
        let mut known: Vec<&str> = schemas().iter().map(|(name, _)| *name).collect();
        sent.sort_unstable();
        known.sort_unstable();
        assert_eq!(sent, known);
        for (_, address, schema, _) in channels() {
            let address = address.replace("{prefix}", "p").replace("{loop}", "A").replace("{id}", "d");
            assert_eq!(schema_of(&address), Some(schema), "{address}");
        }
        let mut references = 0;
        let mut open: Vec<&Value> = vec![&whole["channels"], &whole["operations"]];
        while let Some(value) = open.pop() {
            if let Some(place) = value.get("$ref").and_then(Value::as_str) {
                references += 1;
                assert!(whole.pointer(place.trim_start_matches('#')).is_some(), "{place}");
            }
            open.extend(value.as_object().into_iter().flat_map(Map::values));
        }
        assert!(references > 20, "{references}");
    }
}

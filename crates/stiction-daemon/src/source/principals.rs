//! Commands for named principals alone: Zenoh's own access control, in the daemon's session.
//!
//! Zenoh does not tell an application who has sent a query: what `source_info` says is the sender's own word. It knows the
//! certificate and the user of each link, though, and its access control acts on them before the query gets here. So the
//! rule holds for those who are linked to the daemon itself. A client sees one link, its router's, and everybody behind
//! it: there the router must do it (`config/hardened-router.json5`).

use std::str::FromStr as _;

use anyhow::{Context, anyhow, bail};
use serde_json::{Value, json};

use stiction_monitor::codec::topic;

/// Everything but queries.
const OTHER_MESSAGES: [&str; 8] = [
    "put",
    "delete",
    "declare_subscriber",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
];

/// Limits commands in a session's configuration to these principals (`cn:NAME`, `user:NAME`).
///
/// # Errors
/// The configuration cannot tell principals apart, or has an access control of its own.
pub fn limit(session: &mut zenoh::Config, prefix: &str, principals: &[String]) -> anyhow::Result<()> {
    if principals.is_empty() {
        return Ok(());
    }
    // As Zenoh has parsed it; what is not set is null.
    let stated =
        |key: &str| session.get_json(key).ok().and_then(|json| Value::from_str(&json).ok()).unwrap_or_default();
    if stated("mode") == "client" {
        bail!(
            "a client sees its router alone, not who is behind it: limit commands there (config/hardened-router.json5)"
        );
    }
    if stated("access_control/enabled") == true {
        bail!("[zenoh] config_file already has access_control; name the principals there, or remove it");
    }
    let by_certificate = principals.iter().any(|p| p.starts_with("cn:"));
    if by_certificate && stated("transport/link/tls/enable_mtls") != true {
        bail!("client certificates are not required; set transport.link.tls.enable_mtls in [zenoh] config_file");
    }
    let by_user = principals.iter().any(|p| p.starts_with("user:"));
    if by_user && !stated("transport/auth/usrpwd/dictionary_file").is_string() {
        bail!("user names are not required; set transport.auth.usrpwd.dictionary_file in [zenoh] config_file");
    }
    let rules = rules(prefix, principals).to_string();
    session.insert_json5("access_control", &rules).map_err(|e| anyhow!("{e}")).context("Zenoh rejects the principals")
}

/// Everybody may do everything but query alarms and gaps, where commands are sent; principals may do that too.
fn rules(prefix: &str, principals: &[String]) -> Value {
    let [plane, daemons, groups] = ["**", "@daemon/**", "@plant/**"].map(|rest| topic::plane(prefix, rest));
    let everything = json!(["**", "@/**", plane, daemons, groups]);
    let harmless =
        json!([topic::plane(prefix, "**/estimate"), topic::plane(prefix, "**/health"), daemons, groups, "@/**"]);
    let subject = |(at, name): (usize, &String)| match name.split_once(':') {
        Some(("cn", name)) => json!({"id": format!("p{at}"), "cert_common_names": [name]}),
        Some((_, name)) => json!({"id": format!("p{at}"), "usernames": [name]}),
        None => json!({"id": format!("p{at}")}),
    };
    let mut subjects: Vec<Value> = principals.iter().enumerate().map(subject).collect();
    let named: Vec<Value> = subjects.iter().map(|s| s["id"].clone()).collect();
    subjects.push(json!({"id": "everybody"}));
    let rule = |id: &str, flow: &str, messages: Value, keys: &Value| json!({"id": id, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys});
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": [
            rule("in", "ingress", json!(OTHER_MESSAGES), &everything),
            rule("out", "egress", json!([&OTHER_MESSAGES[..], &["query"]].concat()), &everything),
            rule("read", "ingress", json!(["query"]), &harmless),
            rule("command", "ingress", json!(["query"]), &everything),
        ],
        "subjects": subjects,
        "policies": [
            {"subjects": ["everybody"], "rules": ["in", "out", "read"]},
            {"subjects": named, "rules": ["command"]},
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(text: &str, principals: &[&str]) -> String {
        let mut config = zenoh::Config::from_json5(text).unwrap();
        let names: Vec<String> = principals.iter().map(|p| (*p).to_owned()).collect();
        limit(&mut config, "p", &names).err().map(|e| e.to_string()).unwrap_or_default()
    }

    #[test]
    fn principals_are_refused_where_nobody_could_tell_them_apart() {
        let mtls = "{mode:\"peer\",transport:{link:{tls:{enable_mtls:true}}}}";
        assert_eq!(said("{}", &[]), "");
        assert_eq!(said(mtls, &["cn:ann"]), "");
        assert!(said("{mode:\"client\"}", &["cn:ann"]).contains("router"));
        assert!(said("{mode:\"peer\"}", &["cn:ann"]).contains("enable_mtls"));
        assert!(said(mtls, &["user:ann"]).contains("dictionary_file"));
        assert_eq!(
            said("{mode:\"peer\",transport:{auth:{usrpwd:{dictionary_file:\"users.txt\"}}}}", &["user:ann"]),
            ""
        );
        let own = "{transport:{link:{tls:{enable_mtls:true}}},access_control:{enabled:true,default_permission:\"deny\",rules:[],subjects:[],policies:[]}}";
        assert!(said(own, &["cn:ann"]).contains("already has access_control"));
    }
}

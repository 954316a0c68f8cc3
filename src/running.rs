//! The running daemon of a configuration, asked by the address of its page.

use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, anyhow, bail, ensure};
use serde_json::{Value, json};
use ureq::Agent;

use stiction_monitor::config::{Config, ConfigChanges};

/// How long the daemon may take to answer.
const WITHIN: Duration = Duration::from_secs(90);
/// What else makes a daemon read its file again.
const OTHERWISE: &str = "`systemctl reload stictiond`, or SIGHUP to the daemon, makes it read its file again too";

/// A daemon that runs.
pub(super) struct Running {
    agent: Agent,
    /// Address of its page, without a slash at the end.
    pub url: String,
    token: Option<String>,
}

impl Running {
    /// The daemon of this configuration: at `url`, else where the configuration says that its page is. `option` is the one that
    /// names the page, for errors.
    ///
    /// # Errors
    /// The configuration names no address, nothing answers there, or the daemon there is of another site.
    pub fn of(config: &Config, url: Option<&str>, option: &str) -> anyhow::Result<Self> {
        let url = match url {
            Some(url) => url.trim_end_matches('/').to_owned(),
            None => page_of(config, option)?,
        };
        let token_file = &config.web.page.token_file;
        let token = (!token_file.is_empty()).then(|| {
            std::fs::read_to_string(Path::new(token_file)).with_context(|| format!("[web] token_file {token_file:?}"))
        });
        let settings = Agent::config_builder()
            .timeout_global(Some(WITHIN))
            .http_status_as_error(false)
            // The token must not go to another place.
            .max_redirects(0)
            .max_redirects_will_error(false)
            .proxy(None);
        let token = token.transpose()?.map(|text| text.trim().to_owned());
        let running = Self { agent: settings.build().into(), url, token };
        let absent = || format!("no daemon answers at {}: start it, or name its page by {option}", running.url);
        let site =
            running.agent.get(running.place("/site")).call().map_err(|error| anyhow!(error)).with_context(absent)?;
        let site = running.answer(site)?;
        let (wanted, found) = (&config.site.prefix, site["prefix"].as_str().unwrap_or_default());
        ensure!(
            found == wanted,
            "{} is the daemon of {found:?}, not of {wanted:?}: name its page by {option}",
            running.url
        );
        Ok(running)
    }

    /// Makes it read its configuration file again; gives what changed.
    ///
    /// # Errors
    /// Why it refuses.
    pub fn reload(&self) -> anyhow::Result<ConfigChanges> {
        self.post("/configuration/reload", &json!({}))
    }

    /// What differs in a text from the configuration in force.
    ///
    /// # Errors
    /// Why it refuses.
    pub fn changes(&self, toml: &str) -> anyhow::Result<ConfigChanges> {
        self.post("/configuration/changes", &json!({"toml": toml}))
    }

    fn place(&self, path: &str) -> String {
        format!("{}/api/v1{path}", self.url)
    }

    fn post(&self, path: &str, body: &Value) -> anyhow::Result<ConfigChanges> {
        let mut request = self.agent.post(self.place(path)).header("content-type", "application/json");
        request = request.header("x-stictiond", "1");
        if let Some(token) = &self.token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        let gone = || format!("the daemon at {} has stopped answering", self.url);
        let answer = request.send(body.to_string().as_bytes()).map_err(|error| anyhow!(error)).with_context(gone)?;
        let changes = self.answer(answer)?;
        serde_json::from_value(changes).with_context(|| format!("{}: not an answer of this version", self.url))
    }

    /// The JSON of an answer.
    fn answer(&self, mut response: ureq::http::Response<ureq::Body>) -> anyhow::Result<Value> {
        let url = &self.url;
        let status = response.status();
        let text = response.body_mut().read_to_string().with_context(|| url.clone())?;
        let body: Value = serde_json::from_str(&text).unwrap_or_default();
        if status.is_success() {
            return Ok(body);
        }
        match body["error"].as_str() {
            Some(why) => bail!("the daemon at {url} refuses: {why}"),
            None => bail!("{url} answers {status}: no page of a daemon ([web] page); {OTHERWISE}"),
        }
    }
}

/// The address of the page that a configuration names, as this machine reaches it.
fn page_of(config: &Config, option: &str) -> anyhow::Result<String> {
    let listen = &config.web.listen;
    ensure!(config.web.enabled && config.web.page.enabled, "the page is switched off ([web] page): {OTHERWISE}");
    let mut address: SocketAddr = listen.parse().with_context(|| listen.clone())?;
    ensure!(address.port() != 0, "[web] listen = {listen:?} names no port: name the daemon's page by {option}");
    if address.ip().is_unspecified() {
        let local = if address.is_ipv4() { [127, 0, 0, 1].into() } else { std::net::Ipv6Addr::LOCALHOST.into() };
        address.set_ip(local);
    }
    Ok(format!("http://{address}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_where_this_machine_reaches_it() {
        let of = |web: &str| {
            page_of(&Config::parse(&format!("[site]\nprefix = \"p\"\n[web]\n{web}")).unwrap(), "--url")
                .map_err(|e| e.to_string())
        };
        for (listen, url) in [
            ("127.0.0.1:8080", "http://127.0.0.1:8080"),
            ("0.0.0.0:81", "http://127.0.0.1:81"),
            ("[::]:82", "http://[::1]:82"),
            ("10.0.0.7:83", "http://10.0.0.7:83"),
        ] {
            assert_eq!(of(&format!("listen = {listen:?}\n")).unwrap(), url);
        }
        assert!(of("listen = \"127.0.0.1:0\"\n").unwrap_err().contains("--url"));
        for off in ["enabled = false\n", "page = false\n"] {
            assert!(of(off).unwrap_err().contains("SIGHUP"));
        }
    }
}

//! The configuration file of a running daemon, read at the start and on each reload.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use crossbeam_channel::{Sender, TrySendError};
use tokio::sync::Semaphore;

use crate::daemon::source::askers::Askers;
use crate::daemon::source::zenoh::Subscriptions;
use crate::runtime::control::{Control, Edit};
use crate::runtime::faults::Faults;
use crate::runtime::view::CurrentConfig;
use stiction_engine::config::{Config, ConfigChanges};
use stiction_engine::shard::Shard;

/// Name of the fault while the file cannot be used.
const FAULT: &str = "config";
/// How long reading the file may take: it may be on a disk that hangs.
const READ_WITHIN: Duration = Duration::from_secs(10);
/// Pause before the next attempt to put a request into the engine's queue.
const AGAIN_AFTER: Duration = Duration::from_millis(20);

/// A configuration file, and the options on the command line that override it.
#[derive(Debug, Clone)]
pub struct ConfigFile {
    /// Its path.
    pub path: PathBuf,
    /// `--id`.
    pub id: Option<String>,
    /// `--shard`.
    pub shard: Option<Shard>,
}

impl ConfigFile {
    /// Reads the file; also returns its text.
    ///
    /// # Errors
    /// It cannot be read, or has faults: all of them, a line each.
    pub fn read(&self) -> anyhow::Result<(Config, String)> {
        let path = self.path.display();
        let text = std::fs::read_to_string(&self.path).with_context(|| path.to_string())?;
        let config = self.parse(&text).map_err(|why| anyhow!("{path}: {why}"))?;
        Ok((config, text))
    }

    /// Parses a text instead of the file's.
    fn parse(&self, text: &str) -> anyhow::Result<Config> {
        let mut config = Config::parse(text).map_err(|faults| {
            let lines: String = faults.iter().map(|fault| format!("\n  {fault}")).collect();
            anyhow!("the configuration has faults:{lines}")
        })?;
        config.shard = self.shard.unwrap_or(config.shard);
        if let Some(id) = &self.id {
            config.daemon.id.clone_from(id);
        }
        Ok(config)
    }

    /// The edit that turns the current configuration into the file's.
    ///
    /// # Errors
    /// Those of [`ConfigFile::read`], or settings that cannot change while the daemon runs.
    fn edit_of(&self, current: &Config) -> anyhow::Result<Edit> {
        let (config, text) = self.read()?;
        let changes = current.changes_to(&config);
        match changes.refusal() {
            Some(why) => bail!("{}: {why}", self.path.display()),
            None => Ok(Edit { config: Arc::new(config), text, changes }),
        }
    }
}

/// Reads the file on a separate thread, one read at a time: a thread that hangs remains until the file responds.
#[derive(Debug, Clone)]
struct FileReader {
    file: ConfigFile,
    reading: Arc<Semaphore>,
}

impl FileReader {
    fn new(file: ConfigFile) -> Self {
        Self { file, reading: Arc::new(Semaphore::new(1)) }
    }

    /// As [`ConfigFile::edit_of`].
    async fn edit(&self, current: Arc<Config>, patience: Duration) -> anyhow::Result<Edit> {
        let late = || anyhow!("{}: the file has not answered yet", self.file.path.display());
        let place = self.reading.clone().try_acquire_owned().map_err(|_| late())?;
        let file = self.file.clone();
        let read = tokio::task::spawn_blocking(move || {
            let _place = place;
            file.edit_of(&current)
        });
        tokio::time::timeout(patience, read).await.map_err(|_| late())?.context("the file could not be read")?
    }
}

/// Applies edits of the configuration file, completely or not at all.
pub struct Reload {
    file: Option<FileReader>,
    current: CurrentConfig,
    control: Sender<Control>,
    askers: Askers,
    subscriptions: Subscriptions,
    faults: Arc<Faults>,
}

/// The parts of the daemon that an edit changes.
pub struct ReloadParts {
    /// The file; `None` if there is none to read again.
    pub file: Option<ConfigFile>,
    /// The configuration in force.
    pub current: CurrentConfig,
    /// Sends to the engine.
    pub control: Sender<Control>,
    /// Replies to requests over the bus.
    pub askers: Askers,
    /// The keys subscribed to.
    pub subscriptions: Subscriptions,
    /// The faults.
    pub faults: Arc<Faults>,
}

impl Reload {
    /// A reload with these parts.
    #[must_use]
    pub fn new(parts: ReloadParts) -> Self {
        let ReloadParts { file, current, control, askers, subscriptions, faults } = parts;
        Self { file: file.map(FileReader::new), current, control, askers, subscriptions, faults }
    }

    /// Reads the file again and applies the changes, which are in force when this returns. A file that cannot be used changes
    /// nothing, and is a fault until a later one can be.
    pub async fn run(&mut self) {
        match self.take_over().await {
            Ok(changes) => {
                self.faults.clear(FAULT);
                let changes = changes.to_string().replace('\n', "; ");
                tracing::info!(%changes, "configuration reloaded; these changes are in force");
            }
            // Faults have one line.
            Err(error) => self.faults.raise(FAULT, format!("{error:#}").replace("\n  ", " ")),
        }
    }

    async fn take_over(&mut self) -> anyhow::Result<ConfigChanges> {
        let file = self.file.as_ref().context("this daemon has no configuration file to read again")?;
        let edit = file.edit(self.current.get(), READ_WITHIN).await;
        let edit = edit.context("the changed configuration is not used, the old one holds")?;
        let (changes, config) = (edit.changes.clone(), edit.config.clone());
        let (answer, answered) = tokio::sync::oneshot::channel();
        let answer = Box::new(move || answer.send(()).unwrap_or(()));
        hand_over(&self.control, Control::Edit { edit: Box::new(edit), answer }).await;
        answered.await.map_err(|_| anyhow!("the daemon is stopping"))?;
        self.current.set(config.clone());
        self.askers.limit(&config.commands);
        let deaf = "the changed configuration is in force, but some loops hear nothing";
        self.subscriptions.follow(&config).await.context(deaf)?;
        Ok(changes)
    }

    /// Ends the subscriptions.
    pub async fn close(self) {
        self.subscriptions.close().await;
    }
}

/// Waits until the engine's queue has taken a request or the engine has ended.
async fn hand_over(control: &Sender<Control>, mut request: Control) {
    while let Err(TrySendError::Full(refused)) = control.try_send(request) {
        request = refused;
        tokio::time::sleep(AGAIN_AFTER).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_does_not_answer_is_waited_for_a_while_and_read_once_it_does() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.toml");
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let reader = FileReader::new(ConfigFile { path: path.clone(), id: None, shard: None });
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let current = Arc::new(Config::with_prefix("p"));
        let edit = |ms: u64| runtime.block_on(reader.edit(current.clone(), Duration::from_millis(ms)));
        for _ in 0..2 {
            assert!(edit(20).err().unwrap().to_string().contains("c.toml: the file has not answered yet"));
        }
        // Opening the other end lets the thread continue.
        std::fs::write(&path, "").unwrap();
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, "[site]\nprefix = \"p\"\n[[loop]]\nname = \"A\"\n").unwrap();
        let read = std::iter::from_fn(|| Some(edit(10_000))).find_map(|edit| {
            std::thread::yield_now();
            edit.ok()
        });
        assert_eq!(read.unwrap().changes.to_string(), "added: A");
    }

    #[test]
    fn a_file_is_used_as_a_whole_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.toml");
        let file = ConfigFile { path: path.clone(), id: Some("a".into()), shard: Shard::new(1, 2) };
        let write = |text: &str| std::fs::write(&path, format!("[site]\nprefix = \"p\"\n{text}")).unwrap();
        write("");
        let (current, _) = file.read().unwrap();
        assert_eq!((current.daemon.id.as_str(), current.shard), ("a", Shard::new(1, 2).unwrap()));
        let refused = |text: &str| {
            write(text);
            file.edit_of(&current).map(|_| ()).unwrap_err().to_string()
        };
        let why = refused("[web]\npage = false\n[[loop]]\nname = \"A\"\n");
        assert!(why.contains("c.toml") && why.contains("web.page") && why.contains("restart the daemon"), "{why}");
        let why = refused("[web]\npge = false\n");
        assert!(why.contains("c.toml") && why.contains("line 4: web.pge"), "{why}");
        write("[commands]\nper_minute = 7\n[[loop]]\nname = \"A\"\n");
        let edit = file.edit_of(&current).unwrap();
        assert_eq!(edit.changes.to_string(), "added: A\nsettings: commands.per_minute");
        assert!(file.edit_of(&edit.config).unwrap().changes.is_empty());
    }
}

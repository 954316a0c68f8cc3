//! wip
use super::{Format, Outcome};
/// wip
#[derive(Debug, clap::Args)]
pub struct Args {}
/// wip
pub fn run(_: &Args, _: Format) -> anyhow::Result<Outcome> {
    Ok(Outcome::Done)
}

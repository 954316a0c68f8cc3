//! `stictiond schema`: the JSON Schemas of the published documents, and the descriptions of the APIs.

use std::path::PathBuf;

use anyhow::Context;

use crate::cli::{Outcome, UsageError, print};
use crate::daemon::asyncapi;
use crate::daemon::documents::{schemas, text};
use crate::web::openapi;

/// Print the JSON Schema (2020-12) of a published document, or list them
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond schema
  stictiond schema stictiond.estimate.v1 > estimate.json
  stictiond schema --out schemas/
  stictiond schema openapi

Documents may have more fields than their schema. Within a version, fields are only added.")]
pub struct Args {
    /// Name of the document, as in its field `schema`; or an API: openapi (the page), openapi-workbench, asyncapi (the bus)
    /// [default: list all documents].
    pub name: Option<String>,
    /// Write all schemas into this folder, one file each.
    #[arg(long, value_name = "DIR", conflicts_with = "name")]
    pub out: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// There is no such document, or the folder cannot be written.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let all = schemas();
    if let Some(folder) = &args.out {
        let place = || folder.display().to_string();
        std::fs::create_dir_all(folder).with_context(place)?;
        for (name, schema) in &all {
            std::fs::write(folder.join(format!("{name}.json")), text(schema)).with_context(place)?;
        }
        return Ok(Outcome::Done);
    }
    let Some(wanted) = &args.name else {
        print(&all.iter().map(|(name, _)| format!("{name}\n")).collect::<String>())?;
        return Ok(Outcome::Done);
    };
    let api = match wanted.as_str() {
        "openapi" => Some(openapi::document(&crate::web::api::operations())),
        "openapi-workbench" => Some(openapi::document(&crate::web::workbench::operations())),
        "asyncapi" => Some(asyncapi::document()),
        _ => None,
    };
    if let Some(api) = api {
        print(&text(&api))?;
        return Ok(Outcome::Done);
    }
    let found = all.iter().find(|(name, _)| name == wanted);
    let (_, schema) = found.ok_or_else(|| {
        let names: Vec<&str> = all.iter().map(|(name, _)| *name).collect();
        UsageError(format!(
            "there is no document {wanted:?}; choose one of {}, openapi, openapi-workbench, asyncapi",
            names.join(", ")
        ))
    })?;
    print(&text(schema))?;
    Ok(Outcome::Done)
}

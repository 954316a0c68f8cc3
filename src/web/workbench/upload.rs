//! Uploads: the body goes to a file as it comes, within bounds of size and time.

use std::io::Write as _;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::Body;
use axum::extract::{RawQuery, State};
use axum::http::{HeaderMap, header};
use axum::{Extension, Json};
use futures_util::TryStreamExt;

use super::Workbench;
use super::fault::Fault;
use super::reading::Upload;
use super::shelf::{FileInfo, UploadSlot};
use crate::web::server::IdleTimer;

/// Time that an upload has before its pace counts.
const GRACE: Duration = Duration::from_secs(5);
/// Least pace from then on, bytes a second. Slower ones would hold places for hours.
const LEAST_PACE: f64 = 32.0 * 1024.0;
/// Uploads at a time.
pub const AT_A_TIME: usize = 4;

/// `POST /files?name=…`.
pub async fn upload(
    State(bench): State<Arc<Workbench>>,
    RawQuery(query): RawQuery,
    idle: Option<Extension<IdleTimer>>,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<FileInfo>, Fault> {
    let upload = Upload::read(query.as_deref().unwrap_or_default())?;
    // Before a byte is taken: an option that is not understood, and what is said to be too large.
    upload.reading.options()?;
    let said = headers.get(header::CONTENT_LENGTH).and_then(|text| text.to_str().ok()?.parse::<u64>().ok());
    bench.shelf.fits(said.unwrap_or(0))?;
    let Ok(_permit) = bench.uploads.try_acquire() else {
        return Err(Fault::too_many(format!("{AT_A_TIME} uploads are under way; try again when one is done")));
    };
    let mut place = bench.shelf.place()?;
    store(&mut place, body, idle.as_deref()).await?;
    // Reading takes long and blocks. The place goes with it, so that a reader who leaves leaves nothing behind.
    let read = tokio::task::spawn_blocking(move || place.keep(&upload.name, upload.reading)).await;
    read.map_err(|_| Fault::own("the file could not be read; see the program's log"))?.map(Json)
}

/// Writes the body to its place.
async fn store(place: &mut UploadSlot, body: Body, idle: Option<&IdleTimer>) -> Result<(), Fault> {
    let mut file = std::fs::File::create_new(&place.path).map_err(|error| disk(&error))?;
    let (began, mut taken, mut pieces) = (Instant::now(), 0_u64, body.into_data_stream());
    loop {
        let until = began + GRACE + Duration::from_secs_f64(taken as f64 / LEAST_PACE);
        let piece = tokio::time::timeout_at(until.into(), pieces.try_next()).await;
        let broken = |error| Fault::wrong(format!("the file ended early: {error}; send it again"));
        let slow = || Fault::too_slow("the upload was too slow; try again, or name the file on the command line");
        let Some(bytes) = piece.map_err(|_| slow())?.map_err(broken)? else { break };
        place.grow(bytes.len() as u64)?;
        taken += bytes.len() as u64;
        if let Some(idle) = idle {
            idle.touch();
        }
        // A page's piece is small: writing it keeps nobody waiting.
        file.write_all(&bytes).map_err(|error| disk(&error))?;
    }
    file.flush().map_err(|error| disk(&error))
}

fn disk(error: &std::io::Error) -> Fault {
    Fault::own(format!("cannot store the file: {error}; free space in the folder for temporary files"))
}

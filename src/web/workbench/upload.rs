//! Uploads: the body is written to a file as it arrives, with limits on size and time.

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

/// Time before an upload's rate is checked.
const GRACE: Duration = Duration::from_secs(5);
/// Lowest rate after that, bytes a second. Slower uploads would occupy places for hours.
const LEAST_PACE: f64 = 32.0 * 1024.0;
/// Most uploads at a time.
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
    // Refuse invalid options, and a stated size that is too large, before taking a byte.
    upload.reading.options()?;
    let said = headers.get(header::CONTENT_LENGTH).and_then(|text| text.to_str().ok()?.parse::<u64>().ok());
    bench.shelf.fits(said.unwrap_or(0))?;
    let Ok(_permit) = bench.uploads.try_acquire() else {
        return Err(Fault::too_many(format!("{AT_A_TIME} uploads are under way; try again when one is done")));
    };
    let mut place = bench.shelf.place()?;
    store(&mut place, body, idle.as_deref()).await?;
    // Reading takes long and blocks. The thread owns the place, so that nothing is left behind if the client disconnects.
    let read = tokio::task::spawn_blocking(move || place.keep(&upload.name, upload.reading)).await;
    read.map_err(|_| Fault::own("the file could not be read; see the program's log"))?.map(Json)
}

/// Writes the body to its file.
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
        // A page's piece is small, so writing it blocks only briefly.
        file.write_all(&bytes).map_err(|error| disk(&error))?;
    }
    file.flush().map_err(|error| disk(&error))
}

fn disk(error: &std::io::Error) -> Fault {
    Fault::own(format!("cannot store the file: {error}; free space in the folder for temporary files"))
}

//! Threads for work that waits for a disk or takes long, so that the threads that answer requests do neither.

use std::sync::Arc;
use std::time::Duration;

use axum::http::StatusCode;
use tokio::sync::Semaphore;

use super::ApiError;

/// How many requests may wait for one kind of work.
const WAITING: usize = 64;

/// Threads for one kind of work.
pub(super) struct Threads {
    places: Arc<Semaphore>,
    waiting: Semaphore,
    patience: Duration,
}

impl Threads {
    /// This many threads; a request waits at most for `patience`, its time in the queue included.
    pub fn new(number: usize, patience: Duration) -> Self {
        Self { places: Arc::new(Semaphore::new(number)), waiting: Semaphore::new(WAITING), patience }
    }

    /// Runs `work` on one of these threads once it is free. If the caller gives up, the thread is occupied until the work has
    /// ended.
    pub async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, ApiError> {
        let busy = || ApiError::busy("too many wait for pictures and recordings already: try again in a moment");
        let failed = |_| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, "the request failed; see the daemon's log");
        let _waiting = self.waiting.try_acquire().map_err(|_| busy())?;
        let turn = async {
            let place = self.places.clone().acquire_owned().await.map_err(|_| busy())?;
            let placed = move || {
                let _place = place;
                work()
            };
            tokio::task::spawn_blocking(placed).await.map_err(failed)
        };
        let late = |_| ApiError::busy("the disk or the machine did not answer in time: try again later");
        tokio::time::timeout(self.patience, turn).await.map_err(late)?
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_that_hangs_takes_its_thread_and_no_answer_until_it_works_again() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let threads = Threads::new(1, Duration::from_millis(20));
        let (release, hang) = std::sync::mpsc::channel::<()>();
        let first = runtime.block_on(threads.run(move || hang.recv().is_err()));
        let second = runtime.block_on(threads.run(|| ()));
        for status in [first.map(drop), second].map(|refused| refused.unwrap_err().status()) {
            assert_eq!(status, StatusCode::SERVICE_UNAVAILABLE);
        }
        drop(release);
        let third = std::iter::from_fn(|| Some(runtime.block_on(threads.run(|| 3)))).find_map(Result::ok);
        assert_eq!(third, Some(3));
    }
}

//! CPU time of this thread: the only meaningful time on a shared machine.

/// CPU time of this thread, s.
#[cfg(target_os = "linux")]
pub fn seconds() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// Other systems use wall time.
#[cfg(not(target_os = "linux"))]
pub fn seconds() -> f64 {
    static START: std::sync::LazyLock<std::time::Instant> = std::sync::LazyLock::new(std::time::Instant::now);
    START.elapsed().as_secs_f64()
}

/// CPU time of one call in ms: median of `rounds` rounds of as many calls as take at least a millisecond.
pub fn ms<T>(rounds: usize, mut call: impl FnMut() -> T) -> f64 {
    let mut once = |calls: usize| {
        let started = seconds();
        for _ in 0..calls {
            std::hint::black_box(call());
        }
        (seconds() - started) * 1e3
    };
    let calls = (1.0 / once(1).max(1e-3)).ceil() as usize;
    let mut all: Vec<f64> = (0..rounds.max(1)).map(|_| once(calls) / calls as f64).collect();
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

/// CPU time of this process over all threads, s.
#[cfg(target_os = "linux")]
pub fn process_seconds() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// Other systems use the time of this thread.
#[cfg(not(target_os = "linux"))]
pub fn process_seconds() -> f64 {
    seconds()
}

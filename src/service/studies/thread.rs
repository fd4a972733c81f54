//! Studies run on threads of their own, of lower priority than the threads that step sessions.

use std::io;
use tokio::sync::oneshot;

/// How much later than a step a study gets a core: on Linux a thread's weight falls by a factor of 1.25 with each step of
/// nice (`sched_prio_to_weight` in kernel/sched/core.c), so beside a busy step a study keeps a tenth of a core. Our choice.
#[cfg(any(target_os = "linux", target_os = "android"))]
const NICE: i32 = 10;

/// Runs `work` on a new thread. The receiver fails if the work panics.
///
/// # Errors
/// If the system has no thread left.
pub fn run<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> io::Result<oneshot::Receiver<T>> {
    let (sender, receiver) = oneshot::channel();
    std::thread::Builder::new().name("sandgait-study".into()).spawn(move || {
        yield_to_steps();
        let _ = sender.send(work());
    })?;
    Ok(receiver)
}

/// Lowers the priority of this thread, and of those that it starts. Only Linux has priorities of threads that a process
/// may lower by itself; elsewhere studies run like steps.
fn yield_to_steps() {
    #[cfg(any(target_os = "linux", target_os = "android"))]
    if let Err(error) = rustix::process::nice(NICE) {
        tracing::warn!(%error, "a study runs with the priority of steps");
    }
}

#[cfg(test)]
mod tests {
    use super::run;

    #[cfg(target_os = "linux")]
    #[test]
    fn a_study_and_its_threads_yield_to_steps() {
        let nice = || rustix::process::getpriority_process(None).unwrap();
        let before = nice();
        let of_study = run(move || (nice(), std::thread::spawn(nice).join().unwrap())).unwrap().blocking_recv();
        assert_eq!(of_study, Ok(((before + super::NICE).min(19), (before + super::NICE).min(19))));
        assert_eq!(nice(), before);
    }

    #[test]
    fn a_panic_of_a_study_is_seen() {
        let failed = run(|| panic!("on purpose")).unwrap().blocking_recv();
        assert!(failed.is_err());
    }
}

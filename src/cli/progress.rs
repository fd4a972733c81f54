//! Progress of a command's work on stderr: a bar on a terminal, and lines where the output goes to a file or a pipe.

use super::say;
use indicatif::{ProgressBar, ProgressStyle};
use parking_lot::Mutex;
use sandgait::Result;
use sandgait::progress::Progress;
use std::io::IsTerminal as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// `--quiet`.
static QUIET: AtomicBool = AtomicBool::new(false);

/// From now on neither progress nor notes are written.
pub fn silence() {
    QUIET.store(true, Ordering::Relaxed);
}

pub fn is_silent() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// What a user may do next.
static NEXT: Mutex<Option<String>> = Mutex::new(None);

/// Keeps what a user may do next until the result has been printed.
pub fn next_step(line: Option<String>) {
    *NEXT.lock() = line;
}

/// Says what a user may do next, if a person reads: on terminals, without `--quiet`.
pub fn say_next() {
    let person = !is_silent() && std::io::stdout().is_terminal() && std::io::stderr().is_terminal();
    if let Some(line) = NEXT.lock().take().filter(|_| person) {
        say::next(line);
    }
}

/// A log gets a line at every tenth of the work, but no line within [`SHORT`] after the start or the last line. It gets
/// at least one line in every [`LONG`]. Our choice, so that short work writes nothing.
const SHORT: Duration = Duration::from_secs(2);
const LONG: Duration = Duration::from_secs(60);

pub struct Bar {
    bar: ProgressBar,
    /// None on a terminal.
    log: Option<Mutex<ProgressLog>>,
}

/// The last line.
struct ProgressLog {
    tenth: u32,
    at: Instant,
}

impl ProgressLog {
    /// The line that is due at `now`.
    fn line(&mut self, done: f64, stage: &str, now: Instant) -> Option<String> {
        let (tenth, passed) = ((10.0 * done) as u32, now.duration_since(self.at));
        if !(tenth > self.tenth && passed >= SHORT || passed >= LONG) {
            return None;
        }
        (self.tenth, self.at) = (tenth, now);
        Some(format!("{:.0} % of {stage}", 100.0 * done))
    }
}

impl Bar {
    /// Steps of the bar: our choice, ten for each percent that it prints.
    const STEPS: u64 = 1000;

    pub fn new() -> Self {
        let style = ProgressStyle::with_template("{bar:20} {percent:>3} %, {eta} left: {wide_msg}");
        if is_silent() {
            return Self { bar: ProgressBar::hidden(), log: None };
        }
        let bar = ProgressBar::new(Self::STEPS).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        let log = (!std::io::stderr().is_terminal()).then(|| Mutex::new(ProgressLog { tenth: 0, at: Instant::now() }));
        Self { bar, log }
    }
}

impl Progress for Bar {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        if let Some(log) = &self.log {
            let line = log.lock().line(done, stage, Instant::now());
            line.iter().for_each(say::note);
            return Ok(());
        }
        self.bar.set_message(stage.to_owned());
        self.bar.set_position((done * Self::STEPS as f64) as u64);
        Ok(())
    }

    fn note(&self, line: &str) {
        if !is_silent() {
            self.bar.suspend(|| say::note(line));
        }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lines that work of `seconds` writes if it reports every tenth of a second, and the times at which they come
    /// [s].
    fn lines(seconds: f64) -> Vec<(f64, String)> {
        let start = Instant::now();
        let mut log = ProgressLog { tenth: 0, at: start };
        let reports = (0..=(10.0 * seconds) as u32).map(|k| f64::from(k) / 10.0);
        let line = |t: f64| Some((t, log.line(t / seconds, "the work", start + Duration::from_secs_f64(t))?));
        reports.filter_map(line).collect()
    }

    #[test]
    fn a_log_has_a_line_every_tenth_and_every_minute() {
        assert!(lines(1.5).is_empty());
        let minute = lines(60.0);
        assert_eq!(minute.len(), 10);
        assert_eq!(minute[0], (6.0, "10 % of the work".into()));
        assert_eq!(lines(5.0).len(), 2);
        let hour = lines(3600.0);
        assert!(hour.windows(2).all(|pair| pair[1].0 - pair[0].0 <= 60.0) && hour.len() == 60, "{}", hour.len());
    }
}

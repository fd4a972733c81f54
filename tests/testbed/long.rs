//! Tests of many cases. `make test` runs as many of them as take seconds, and `make test-long` runs all.

#![allow(dead_code, reason = "each program uses some of these")]

/// The first in `make test`, the second in `make test-long`.
pub fn either<T>(short: T, long: T) -> T {
    if std::env::var_os("SANDGAIT_TEST_LONG").is_some() { long } else { short }
}

/// The first `few` of all cases, and all of them in `make test-long`.
pub fn first<T>(few: usize, all: impl IntoIterator<Item = T>) -> impl Iterator<Item = T> {
    all.into_iter().take(either(few, usize::MAX))
}

/// Every n-th of all cases, and all of them in `make test-long`.
pub fn every<T>(n: usize, all: impl IntoIterator<Item = T>) -> impl Iterator<Item = T> {
    all.into_iter().step_by(either(n, 1))
}

//! Denormal numbers are the smallest floating-point numbers. A processor may take a hundred times as long to compute
//! with them.
//!
//! All code that advances a robot treats denormal numbers as zero ([`flushed`]). In `f32` they are below 1.2e-38, far
//! below any meaningful force, speed or angle, so nothing is lost. Each thread has its own setting of the processor. An
//! engine changes the setting when it begins to advance, and restores it at the end. So results are bit-identical on
//! every thread, in every batch, in this process and in a server, and the caller's thread (Python's, for example) keeps
//! its own setting.

/// Runs `work` while the processor treats denormal operands and results as zero. Restores the previous setting, also on
/// a panic.
///
/// Works on x86-64 and aarch64; on other processors it only runs `work`.
pub fn flushed<T>(work: impl FnOnce() -> T) -> T {
    with(|word| word | control::FLUSH, work)
}

/// Runs `work` with denormal numbers, as code of others expects.
pub fn unflushed<T>(work: impl FnOnce() -> T) -> T {
    with(|word| word & !control::FLUSH, work)
}

#[inline(never)] // not inlined: the compiler must not move arithmetic into or out of `work`
fn with<T>(setting: impl FnOnce(control::Word) -> control::Word, work: impl FnOnce() -> T) -> T {
    struct Restore(control::Word);
    impl Drop for Restore {
        fn drop(&mut self) {
            control::write(self.0);
        }
    }
    let before = control::read();
    let _restore = Restore(before);
    control::write(setting(before));
    run(work)
}

#[inline(never)]
fn run<T>(work: impl FnOnce() -> T) -> T {
    work()
}

/// The SSE control and status register, MXCSR (Intel 64 and IA-32 Software Developer's Manual, volume 1, 10.2.3).
#[cfg(target_arch = "x86_64")]
mod control {
    use std::arch::asm;

    pub type Word = u32;
    /// Flush to zero (bit 15) and denormals are zero (bit 6).
    pub const FLUSH: Word = 1 << 15 | 1 << 6;

    pub fn read() -> Word {
        let mut word: Word = 0;
        // SAFETY: writes the register to `word`.
        unsafe { asm!("stmxcsr [{}]", in(reg) &raw mut word, options(nostack, preserves_flags)) };
        word
    }

    pub fn write(word: Word) {
        // SAFETY: `word` is the register's value with at most two bits changed. Rounding and exception masks stay
        // as the language expects them; only numbers below 1.2e-38 are affected.
        unsafe { asm!("ldmxcsr [{}]", in(reg) &raw const word, options(nostack, preserves_flags)) };
    }
}

/// The floating-point control register, FPCR (Arm Architecture Reference Manual, C5.2.8).
#[cfg(target_arch = "aarch64")]
mod control {
    use std::arch::asm;

    pub type Word = u64;
    /// Flush to zero, of operands and results (bit 24).
    pub const FLUSH: Word = 1 << 24;

    pub fn read() -> Word {
        let word: Word;
        // SAFETY: reads a register.
        unsafe { asm!("mrs {}, fpcr", out(reg) word, options(nomem, nostack, preserves_flags)) };
        word
    }

    pub fn write(word: Word) {
        // SAFETY: writes back the register's value with at most one bit changed. Rounding and exception masks stay
        // as the language expects them; only numbers below 1.2e-38 are affected.
        unsafe { asm!("msr fpcr, {}", in(reg) word, options(nostack, preserves_flags)) };
    }
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
mod control {
    pub type Word = u32;
    pub const FLUSH: Word = 0;
    pub fn read() -> Word {
        0
    }
    pub fn write(_word: Word) {}
}

/// For tests: did this thread compute with a denormal operand while `work` ran? The processor sets a flag (MXCSR, bit
/// 1), so the test also notices intermediate results.
#[cfg(target_arch = "x86_64")]
pub fn met_denormals(work: impl FnOnce()) -> bool {
    const DENORMAL_OPERAND: control::Word = 1 << 1;
    let before = control::read();
    control::write(before & !(DENORMAL_OPERAND | control::FLUSH));
    run(work);
    let after = control::read();
    control::write(before);
    after & DENORMAL_OPERAND != 0
}

#[cfg(all(test, any(target_arch = "x86_64", target_arch = "aarch64")))]
mod tests {
    use super::*;
    use std::hint::black_box;

    fn halved_smallest() -> f32 {
        black_box(f32::MIN_POSITIVE) * black_box(0.5)
    }

    #[test]
    fn denormals_are_zero_inside_and_numbers_outside() {
        assert_eq!(flushed(halved_smallest), 0.0);
        assert!(halved_smallest() > 0.0);
        assert!(flushed(|| unflushed(halved_smallest)) > 0.0);
        let caught = std::panic::catch_unwind(|| flushed(|| panic!("on purpose")));
        assert!(caught.is_err() && halved_smallest() > 0.0);
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn the_processor_notices_denormals() {
        assert!(met_denormals(|| {
            black_box(halved_smallest() * black_box(3.0));
        }));
        assert!(!met_denormals(|| {
            black_box(black_box(2.0_f32) * black_box(3.0));
        }));
    }
}

//! Denormal numbers: so small that a processor may take a hundred times as long for them.
//!
//! The decision for the whole program: everything that advances a robot runs with denormal numbers counted as zero
//! ([`flushed`]). In `f32` they are below 1.2e-38, far below what a force, speed or angle can mean, so nothing is lost.
//! The setting belongs to the processor's thread; it is made where an engine begins to advance and undone where it ends.
//! So the bits are the same on every thread, in every batch, in this process or in a server, and a caller's thread
//! (Python's, say) keeps its own setting.

/// Runs `work` with denormal operands and results counted as zero, and restores what was set before, also on a panic.
///
/// x86-64 and aarch64; elsewhere it only runs `work`.
#[inline(never)] // no arithmetic of the caller may move in, none of `work` out
pub fn flushed<T>(work: impl FnOnce() -> T) -> T {
    struct Restore(control::Word);
    impl Drop for Restore {
        fn drop(&mut self) {
            control::write(self.0);
        }
    }
    let before = control::read();
    let _restore = Restore(before);
    control::write(before | control::FLUSH);
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
        // SAFETY: stores the register into `word`.
        unsafe { asm!("stmxcsr [{}]", in(reg) &raw mut word, options(nostack, preserves_flags)) };
        word
    }

    pub fn write(word: Word) {
        // SAFETY: `word` was read from the register, with two bits of its own set at most. Rounding and exception masks
        // stay as the language expects them; what changes is the value of numbers below 1.2e-38 alone.
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
        // SAFETY: as on x86-64.
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

/// Has this thread computed with a denormal operand while `work` ran? The processor keeps count (MXCSR, bit 1), so even a
/// number that no array holds is noticed. For tests of other crates.
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

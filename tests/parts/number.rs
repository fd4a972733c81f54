//! The number types give the same results as `f64`, lane by lane.

use sandgait::number::{Isa, Kernel, Real, Work};

/// Checks the largest error of sine and cosine over ±100 rad, and of the other operations, in every lane.
struct Check<R>(std::marker::PhantomData<R>);

impl<R: Real> Kernel for Check<R> {
    #[inline(always)]
    fn run(self) {
        for i in -4000..4000 {
            let mut x = R::zero();
            for lane in 0..R::LANES {
                x.set_lane(lane, (f64::from(i) + 0.13 * lane as f64) * 0.025);
            }
            let (sin, cos) = x.sin_cos();
            let (root, smaller, larger) = (x.abs().sqrt(), x.min(R::one()), x.max(R::one()));
            let chosen = R::select(x.lt(R::zero()), -x, x * R::splat(2.0));
            for lane in 0..R::LANES {
                let v = x.lane(lane);
                assert!((sin.lane(lane) - v.sin()).abs() < 2e-7, "sin {v}: {}", sin.lane(lane));
                assert!((cos.lane(lane) - v.cos()).abs() < 2e-7, "cos {v}: {}", cos.lane(lane));
                assert!((root.lane(lane) - v.abs().sqrt()).abs() < 1e-6);
                assert_eq!((smaller.lane(lane), larger.lane(lane)), (v.min(1.0), v.max(1.0)));
                assert_eq!(chosen.lane(lane), if v < 0.0 { -v } else { 2.0 * v });
                assert_eq!(x.round().lane(lane), v.round_ties_even());
            }
        }
    }
}

#[test]
fn every_number_type_computes_alike() {
    f32::dispatch(Check::<f32>(std::marker::PhantomData));
    for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
        isa.with(Compiled).unwrap();
    }
}

/// Runs the check with the number type of an instruction set.
struct Compiled;

impl Work for Compiled {
    type Out = ();

    fn run<R: Real>(self) {
        R::dispatch(Check::<R>(std::marker::PhantomData));
    }
}

#[test]
fn what_the_machine_has_not_is_refused() {
    for isa in Isa::ALL {
        assert_eq!(isa.with(Compiled).is_ok(), isa.available(), "{isa:?}");
    }
}

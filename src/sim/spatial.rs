//! Spatial algebra about one common point: wrenches and inertias of all bodies are in one shared, world-aligned frame,
//! so that those of child and parent add. After R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapters 2 and
//! 7.

use crate::number::{Mat3, Real, Vec3};

/// Moment about the common point and force.
#[derive(Clone, Copy)]
pub struct Wrench<R> {
    pub moment: Vec3<R>,
    pub force: Vec3<R>,
}

/// Angular part, and linear part at the common point: a velocity, an acceleration or a joint axis.
#[derive(Clone, Copy)]
pub struct Twist<R> {
    pub angular: Vec3<R>,
    pub linear: Vec3<R>,
}

impl<R: Real> Wrench<R> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { moment: Vec3::zero(), force: Vec3::zero() }
    }
    #[inline(always)]
    pub fn add(&mut self, o: &Self) {
        self.moment += o.moment;
        self.force += o.force;
    }
    /// `self * s + o`
    #[inline(always)]
    pub fn scale_add(&self, s: R, o: &Self) -> Self {
        Self { moment: self.moment.scale_add(s, o.moment), force: self.force.scale_add(s, o.force) }
    }
    /// Power of this wrench on a twist.
    #[inline(always)]
    pub fn dot(&self, t: &Twist<R>) -> R {
        self.moment.dot(t.angular) + self.force.dot(t.linear)
    }
}

impl<R: Real> Twist<R> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { angular: Vec3::zero(), linear: Vec3::zero() }
    }
    /// `axis` through `point`.
    #[inline(always)]
    pub fn hinge(axis: Vec3<R>, point: Vec3<R>) -> Self {
        Self { angular: axis, linear: point.cross(axis) }
    }
    /// `self * s + o`
    #[inline(always)]
    pub fn scale_add(&self, s: R, o: &Self) -> Self {
        Self { angular: self.angular.scale_add(s, o.angular), linear: self.linear.scale_add(s, o.linear) }
    }
    #[inline(always)]
    pub fn scaled(&self, s: R) -> Self {
        Self { angular: self.angular * s, linear: self.linear * s }
    }
    /// Velocity of the body-fixed point at `r` from the common point.
    #[inline(always)]
    pub fn at(&self, r: Vec3<R>) -> Vec3<R> {
        self.linear + self.angular.cross(r)
    }
    /// Rate of change of a twist `other` that is fixed to a body with this velocity.
    #[inline(always)]
    pub fn carries(&self, other: &Self) -> Self {
        Self {
            angular: self.angular.cross(other.angular),
            linear: self.angular.cross(other.linear) + self.linear.cross(other.angular),
        }
    }
}

/// A symmetric 3×3 matrix: diagonal xx, yy, zz and off-diagonal xy, xz, yz.
#[derive(Clone, Copy)]
pub struct Symmetric<R> {
    pub diagonal: Vec3<R>,
    pub off: Vec3<R>,
}

impl<R: Real> Symmetric<R> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { diagonal: Vec3::zero(), off: Vec3::zero() }
    }
    #[inline(always)]
    pub fn apply(&self, v: Vec3<R>) -> Vec3<R> {
        let (d, o) = (self.diagonal, self.off);
        Vec3::new(
            d.x.mul_add(v.x, o.x.mul_add(v.y, o.y * v.z)),
            o.x.mul_add(v.x, d.y.mul_add(v.y, o.z * v.z)),
            o.y.mul_add(v.x, o.z.mul_add(v.y, d.z * v.z)),
        )
    }
    #[inline(always)]
    pub fn add(&mut self, o: &Self) {
        self.diagonal += o.diagonal;
        self.off += o.off;
    }
    /// Adds `s a aᵀ`.
    #[inline(always)]
    pub fn add_outer(&mut self, s: R, a: Vec3<R>) {
        let (x, y, z) = (a.x * s, a.y * s, a.z * s);
        let (d, o) = (&mut self.diagonal, &mut self.off);
        *d = Vec3::new(a.x.mul_add(x, d.x), a.y.mul_add(y, d.y), a.z.mul_add(z, d.z));
        *o = Vec3::new(a.x.mul_add(y, o.x), a.x.mul_add(z, o.y), a.y.mul_add(z, o.z));
    }
    /// Adds `a bᵀ`. The sum of all added products must be symmetric.
    #[inline(always)]
    pub fn add_product(&mut self, a: Vec3<R>, b: Vec3<R>) {
        let (d, o) = (&mut self.diagonal, &mut self.off);
        *d = Vec3::new(a.x.mul_add(b.x, d.x), a.y.mul_add(b.y, d.y), a.z.mul_add(b.z, d.z));
        *o = Vec3::new(a.x.mul_add(b.y, o.x), a.x.mul_add(b.z, o.y), a.y.mul_add(b.z, o.z));
    }
    /// `m self mᵀ` for a rotation `m`.
    #[inline(always)]
    pub fn rotated(&self, m: &Mat3<R>) -> Self {
        let (d, o) = (self.diagonal, self.off);
        // columns of m self
        let a = m.apply(Vec3::new(d.x, o.x, o.y));
        let b = m.apply(Vec3::new(o.x, d.y, o.z));
        let c = m.apply(Vec3::new(o.y, o.z, d.z));
        let entry = |i: fn(&Vec3<R>) -> R, j: fn(&Vec3<R>) -> R| {
            i(&a).mul_add(j(&m.x), i(&b).mul_add(j(&m.y), i(&c) * j(&m.z)))
        };
        Self {
            diagonal: Vec3::new(entry(|v| v.x, |v| v.x), entry(|v| v.y, |v| v.y), entry(|v| v.z, |v| v.z)),
            off: Vec3::new(entry(|v| v.x, |v| v.y), entry(|v| v.x, |v| v.z), entry(|v| v.y, |v| v.z)),
        }
    }
}

/// Point masses, represented by sums of their moments: the masses of a link, and masses that represent sand's implicit drag.
#[derive(Clone, Copy)]
pub struct PointMasses<R> {
    pub mass: R,
    /// Σ m r
    pub first: Vec3<R>,
    /// Σ m r rᵀ
    pub second: Symmetric<R>,
}

impl<R: Real> PointMasses<R> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { mass: R::zero(), first: Vec3::zero(), second: Symmetric::zero() }
    }
}

/// Articulated inertia: moment = `rotary` α + `coupling` a, force = `coupling`ᵀ α + `linear` a.
#[derive(Clone, Copy)]
pub struct Inertia<R> {
    pub rotary: Symmetric<R>,
    pub coupling: Mat3<R>,
    pub linear: Symmetric<R>,
}

impl<R: Real> Inertia<R> {
    /// A rigid body with `rotary` inertia whose centre of mass is the common point.
    #[inline(always)]
    pub fn central(mass: R, rotary: Symmetric<R>) -> Self {
        let coupling = Mat3::new(Vec3::zero(), Vec3::zero(), Vec3::zero());
        let linear = Symmetric { diagonal: Vec3::new(mass, mass, mass), off: Vec3::zero() };
        Self { rotary, coupling, linear }
    }

    /// A rigid body with `rotary` inertia about its centre of mass, which is at `c`.
    #[inline(always)]
    pub fn at(mass: R, c: Vec3<R>, rotary: Symmetric<R>) -> Self {
        let (mc, zero) = (c * mass, R::zero());
        let (xx, yy, zz) = (mc.x * c.x, mc.y * c.y, mc.z * c.z);
        let diagonal = rotary.diagonal + Vec3::new(yy + zz, xx + zz, xx + yy);
        let off = rotary.off - Vec3::new(mc.x * c.y, mc.x * c.z, mc.y * c.z);
        Self {
            rotary: Symmetric { diagonal, off },
            coupling: crossing(mc),
            linear: Symmetric { diagonal: Vec3::new(mass, mass, mass), off: Vec3::new(zero, zero, zero) },
        }
    }

    /// Point masses that move as one.
    #[inline(always)]
    pub fn points(masses: &PointMasses<R>) -> Self {
        let (mass, first, second) = (masses.mass, masses.first, &masses.second);
        let trace = second.diagonal.x + second.diagonal.y + second.diagonal.z;
        let trace = Vec3::new(trace, trace, trace);
        Self {
            rotary: Symmetric { diagonal: trace - second.diagonal, off: -second.off },
            coupling: crossing(first),
            linear: Symmetric { diagonal: Vec3::new(mass, mass, mass), off: Vec3::zero() },
        }
    }

    #[inline(always)]
    pub fn add(&mut self, o: &Self) {
        self.rotary.add(&o.rotary);
        self.coupling.x += o.coupling.x;
        self.coupling.y += o.coupling.y;
        self.coupling.z += o.coupling.z;
        self.linear.add(&o.linear);
    }

    #[inline(always)]
    pub fn apply(&self, t: &Twist<R>) -> Wrench<R> {
        Wrench {
            moment: self.rotary.apply(t.angular) + self.coupling.apply(t.linear),
            force: self.coupling.apply_transposed(t.angular) + self.linear.apply(t.linear),
        }
    }

    /// Adds Σ s w wᵀ for wrenches w with the same force `force` and different moments m; `moments` holds Σs, Σsm and
    /// Σsmmᵀ.
    #[inline(always)]
    pub fn add_outers(&mut self, moments: &PointMasses<R>, force: Vec3<R>) {
        self.rotary.add(&moments.second);
        self.linear.add_outer(moments.mass, force);
        self.coupling.x = moments.first.scale_add(force.x, self.coupling.x);
        self.coupling.y = moments.first.scale_add(force.y, self.coupling.y);
        self.coupling.z = moments.first.scale_add(force.z, self.coupling.z);
    }

    /// Adds `s w wᵀ`.
    #[inline(always)]
    pub fn add_outer(&mut self, s: R, w: &Wrench<R>) {
        self.rotary.add_outer(s, w.moment);
        self.linear.add_outer(s, w.force);
        let m = w.moment * s;
        self.coupling.x = m.scale_add(w.force.x, self.coupling.x);
        self.coupling.y = m.scale_add(w.force.y, self.coupling.y);
        self.coupling.z = m.scale_add(w.force.z, self.coupling.z);
    }

    /// The twist t with `self t = w`, by Cholesky factors L D Lᵀ of the 6×6 matrix (linear rows first: they dominate).
    #[inline(always)]
    pub fn solve(&self, w: &Wrench<R>) -> Twist<R> {
        let (l, c, r) = (&self.linear, &self.coupling, &self.rotary);
        let (zero, row) = (R::zero(), |v: &dyn Fn(Vec3<R>) -> R| [v(c.x), v(c.y), v(c.z)]);
        let [cx, cy, cz] = [row(&|v| v.x), row(&|v| v.y), row(&|v| v.z)];
        let mut a = [
            [l.diagonal.x, zero, zero, zero, zero, zero],
            [l.off.x, l.diagonal.y, zero, zero, zero, zero],
            [l.off.y, l.off.z, l.diagonal.z, zero, zero, zero],
            [cx[0], cx[1], cx[2], r.diagonal.x, zero, zero],
            [cy[0], cy[1], cy[2], r.off.x, r.diagonal.y, zero],
            [cz[0], cz[1], cz[2], r.off.y, r.off.z, r.diagonal.z],
        ];
        let mut b = [w.force.x, w.force.y, w.force.z, w.moment.x, w.moment.y, w.moment.z];
        let mut inverse = [zero; 6];
        for j in 0..6 {
            inverse[j] = R::one() / a[j][j];
            for i in j + 1..6 {
                let factor = a[i][j] * inverse[j];
                let column: [R; 6] = std::array::from_fn(|k| a[k][j]);
                for (entry, c) in a[i][j + 1..=i].iter_mut().zip(&column[j + 1..]) {
                    *entry -= factor * *c;
                }
                b[i] -= factor * b[j];
            }
            // rows below still hold the unscaled column j, which the back substitution uses
        }
        for j in (0..6).rev() {
            for i in j + 1..6 {
                b[j] -= a[i][j] * b[i];
            }
            b[j] = b[j] * inverse[j];
        }
        Twist { angular: Vec3::new(b[3], b[4], b[5]), linear: Vec3::new(b[0], b[1], b[2]) }
    }
}

/// [v ×]
#[inline(always)]
fn crossing<R: Real>(v: Vec3<R>) -> Mat3<R> {
    let zero = R::zero();
    Mat3::new(Vec3::new(zero, v.z, -v.y), Vec3::new(-v.z, zero, v.x), Vec3::new(v.y, -v.x, zero))
}

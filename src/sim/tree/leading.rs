//! The part of a patch of plates that leads in the sand.

use super::patches::{BodyPatches, Facet, Panel, Patch, Tile};
use crate::number::{Real, Spread, Vec3};
use crate::sand::StressModel;
use crate::sand::mechanism_laws::{RestingShare, SlidingFace};

/// The velocity of a body and the sand's surface, both in the body's frame.
pub(super) struct Own<R> {
    pub(super) linear: Vec3<R>,
    pub(super) angular: Vec3<R>,
    pub(super) up: Vec3<R>,
    /// Height of the body's origin above the surface [m].
    pub(super) height: R,
}

impl BodyPatches {
    /// Horizontal extent of the box around the plates, perpendicular to the velocity of the box's centre [m]. If the
    /// body moves up or down, this is the extent along its own y: legs swing in their x-z plane.
    #[inline(always)]
    pub(super) fn width<R: Real>(&self, own: &Own<R>) -> R {
        let middle = Vec3::splat(self.ball.center);
        let speed = own.linear + own.angular.cross(middle);
        let y = Vec3::splat([0.0, 1.0, 0.0]);
        let level = y - own.up * own.up.y;
        let still = speed.norm_squared().mul_add(R::splat(1e-6), R::splat(1e-12)).sqrt();
        let across = level.scale_add(still, own.up.cross(speed));
        let length = across.norm_squared().max(R::splat(1e-20)).sqrt();
        let [low, high] = [self.corners[0], self.corners[7]];
        let extent = |k: usize, along: R| along.abs() * R::splat(high[k] - low[k]);
        (extent(0, across.x) + extent(1, across.y) + extent(2, across.z)) / length
    }
}

/// The leading part of a patch in the sand, as sums over its plates.
pub(super) struct Leading<R> {
    /// [m²]
    pub(super) area: R,
    /// ∫ depth dA [m³]. The next sums have a further factor in the integral: depth; normal; the products of its
    /// components (xx, yy, zz; yz, xz, xy); place.
    pub(super) load: R,
    pub(super) deep: R,
    pub(super) normal: Vec3<R>,
    pub(super) squares: Vec3<R>,
    pub(super) products: Vec3<R>,
    pub(super) place: Vec3<R>,
    /// Derivative of `load` with respect to n·v̂ [m³].
    pub(super) growth: R,
    /// 0 unless `sliding_face` is on.
    pub(super) resting: Resting<R>,
}

/// The sand at rest on plates that slide along themselves, as sums over the plates of a patch.
pub(super) struct Resting<R> {
    /// Σ load [m³], see [`SlidingFace::force`]; the next sums have a further factor: normal; place.
    pub(super) load: R,
    pub(super) normal: Vec3<R>,
    pub(super) place: Vec3<R>,
    /// Derivative of `load` with respect to n·v̂ [m³].
    pub(super) slope: R,
}

/// The hottest loop in simulations of robots on sand.
#[inline(always)]
pub(super) fn leading<R: Real, M: StressModel<R>, S: Spread<R>, D>(
    patch: &Patch<S, D>,
    own: &Own<R>,
    inverse_speed: R,
    sliding: Option<&SlidingFace<R>>,
) -> Leading<R> {
    let (zero, one) = (R::zero(), R::one());
    let own = Own { linear: own.linear * inverse_speed, angular: own.angular * inverse_speed, ..*own };
    let mut sum = Leading::none();
    for facet in &patch.facets {
        let normal: Vec3<R> = lanes(&facet.normal);
        let along = facet.along(&own);
        let (begun, growth, edge) = facet.rise_of_share(sliding);
        let share = along.mul_add(growth, begun);
        let depth = -(own.up.dot(lanes(&facet.center)) + own.height);
        // The factor of `rise` is about √(1 − x²): at most 0.17 too small (near x = 0.94), and 0.04 on average over all directions.
        let x = normal.dot(own.up);
        let flat = x * x;
        let rise = facet.rise.spread() * (one - flat) * flat.mul_add(R::splat(0.6), one);
        let (low, high) = (depth + rise, depth - rise);
        let part = share.clamp(zero, one) * facet.area.spread();
        let half = part * R::splat(0.5);
        let (lower, upper) = (low.max(zero), high.max(zero));
        if !M::BY_LOAD {
            sum.deep = half.mul_add(lower.mul_add(lower, upper * upper), sum.deep);
            sum.area += R::select(zero.lt(low), half, zero) + R::select(zero.lt(high), half, zero);
        }
        sum.add(facet, normal, half * (lower + upper));
        sum.grow(share, edge, depth);
        if let Some(face) = sliding {
            let wet = facet.area.spread() * R::splat(0.5) * (lower + upper);
            sum.resting.add(facet, wet * SlidingFace::pressure(x), face.resting(along, begun / growth));
        }
    }
    for panel in &patch.panels {
        panel.press::<R, M>(&own, &mut sum, sliding);
    }
    for tile in &patch.tiles {
        tile.press::<R, M>(&own, &mut sum, sliding);
    }
    // n·n = 1, also in the mean over a bent plate, so the three squares add up to the load.
    sum.squares.z = sum.load - sum.squares.x - sum.squares.y;
    sum
}

impl<S> Facet<S> {
    /// n·v̂ of the plate's centre.
    #[inline(always)]
    fn along<R: Real>(&self, own: &Own<R>) -> R
    where
        S: Spread<R>,
    {
        lanes(&self.normal).dot(own.linear) + lanes(&self.moment).dot(own.angular)
    }

    /// `begun`, `growth` and `edge`. With `sliding_face` the share rises from −w to w + κ, where −w to w is its range for
    /// a bent plate without the mechanism; for a flat one w is 0.
    #[inline(always)]
    fn rise_of_share<R: Real>(&self, sliding: Option<&SlidingFace<R>>) -> (R, R, R)
    where
        S: Spread<R>,
    {
        let (begun, growth, edge): (R, R, R) = (self.begun.spread(), self.growth.spread(), self.edge.spread());
        let Some(face) = sliding else { return (begun, growth, edge) };
        let before = begun / growth;
        let flat = R::select(R::zero().lt(begun), R::zero(), R::one() / growth);
        let slower = R::one() / (before + before + face.range(flat));
        (
            face.where_on(before * slower, begun),
            face.where_on(slower, growth),
            face.where_on(slower * self.area.spread(), edge),
        )
    }

    /// Volume of sand above a plate [m³], weighted by the pressure of sand at rest, for a plate whose depth changes by
    /// ± `rise` and whose centre is at `depth`.
    #[inline(always)]
    fn resting_load<R: Real>(&self, up: Vec3<R>, depth: R, rise: R) -> R
    where
        S: Spread<R>,
    {
        let low = (depth + rise).max(R::zero());
        let wet = (R::splat(0.5) * low / rise).min(R::one());
        let pressure = SlidingFace::pressure(lanes(&self.normal).dot(up));
        self.area.spread() * wet * (low - rise * wet) * pressure
    }
}

impl<S> Tile<S> {
    /// Adds its leading part in the sand, with the distribution of depths of [`Panel::press`].
    #[inline(always)]
    fn press<R: Real, M: StressModel<R>>(&self, own: &Own<R>, sum: &mut Leading<R>, sliding: Option<&SlidingFace<R>>)
    where
        S: Spread<R>,
    {
        let (zero, one, facet) = (R::zero(), R::one(), &self.facet);
        let halves = [lanes::<R, S>(&self.half[0]), lanes(&self.half[1])];
        let slopes = [halves[0].dot(own.up), halves[1].dot(own.up)];
        // Because the body turns, n·v̂ at the plate's corners differs by up to ± `spread` from n·v̂ at its centre.
        let turning = own.angular.cross(lanes(&facet.normal));
        let spread = halves[0].dot(turning).abs() + halves[1].dot(turning).abs();
        let gate = R::splat(crate::sand::Regularization::SOLID.leading_edge_gate);
        let growth = one / spread.mul_add(R::splat(2.0), sliding.map_or(gate, |face| face.range(gate)));
        let share = (facet.along(own) + spread) * growth;
        let rise = slopes[0].mul_add(slopes[0], slopes[1].mul_add(slopes[1], R::splat(1e-20))).sqrt();
        let depth = -(own.up.dot(lanes(&facet.center)) + own.height);
        let low = (depth + rise).max(zero);
        let wet = (R::splat(0.5) * low / rise).min(one);
        let range = rise * wet;
        let mean = low - range;
        let part = share.clamp(zero, one) * facet.area.spread() * wet;
        if !M::BY_LOAD {
            sum.area += part;
            sum.deep = part.mul_add(mean.mul_add(mean, range * range * R::splat(1.0 / 3.0)), sum.deep);
        }
        sum.add(facet, lanes(&facet.normal), part * mean);
        sum.grow(share, growth * facet.area.spread(), depth);
        if let Some(face) = sliding {
            let load = facet.resting_load(own.up, depth, rise);
            sum.resting.add(facet, load, face.resting(facet.along(own), spread));
        }
    }
}

impl<S> Panel<S> {
    /// Adds its leading part in the sand. The depth of that part is taken as evenly distributed between its lowest and
    /// its highest point, which is exact if the depth changes in one direction only.
    #[inline(always)]
    fn press<R: Real, M: StressModel<R>>(&self, own: &Own<R>, sum: &mut Leading<R>, sliding: Option<&SlidingFace<R>>)
    where
        S: Spread<R>,
    {
        let (zero, one, facet) = (R::zero(), R::one(), &self.facet);
        let sides: [Vec3<R>; 2] = [lanes(&self.half[0]), lanes(&self.half[1])];
        let [bent, straight] = [sides[0].dot(own.up), sides[1].dot(own.up)];
        let turn: Vec3<R> = lanes(&self.turn);
        // n·v̂ changes by ± `spread` towards the edges of the bent side. Names that end in `_s` are for numbers
        // multiplied by `spread`, so that one division suffices.
        let turning = turn.dot(own.linear);
        let (half, third) = (R::splat(0.5), R::splat(1.0 / 3.0));
        let least = R::splat(crate::sand::Regularization::SOLID.leading_edge_gate / 2.0);
        let (mut along, mut spread) = (facet.along(own), turning.abs());
        if let Some(face) = sliding {
            // From −`turning` to `turning` + κ.
            let later = half * face.range(zero);
            (along, spread) = (along - later, spread + later);
        }
        let spread = spread.max(least);
        let leads_s = (half * (along + spread)).clamp(zero, spread);
        // The part that is turned towards the velocity leads: its middle (`ahead_s`) and its share of the length
        // (`leads_s`).
        let ahead_s = R::select(turning.lt(zero), leads_s - spread, spread - leads_s);
        let rise_s = leads_s * bent;
        let flat = spread * spread * straight.mul_add(straight, R::splat(1e-20));
        let rise_s = rise_s.mul_add(rise_s, flat).sqrt();
        let depth = -(own.up.dot(lanes(&facet.center)) + own.height);
        let low_s = depth.mul_add(spread, rise_s - ahead_s * bent).max(zero);
        let inverse = one / (spread * rise_s);
        let (per_spread, per_rise_s) = (inverse * rise_s, inverse * spread);
        // The part in the sand: its share, half the range of its depths, and their mean.
        let wet = (half * low_s * per_rise_s).min(one);
        let range_s = rise_s * wet;
        let mean_s = low_s - range_s;
        // Rounding must not give a panel that leads as a whole an edge, from which drag would follow.
        let leads = R::select(leads_s.lt(spread), leads_s * per_spread, one);
        let (mean, ahead) = (mean_s * per_spread, ahead_s * per_spread);
        let part = leads * facet.area.spread() * wet;
        let load = part * mean;
        if !M::BY_LOAD {
            let range = range_s * per_spread;
            sum.area += part;
            sum.deep = part.mul_add(mean.mul_add(mean, range * range * third), sum.deep);
        }
        sum.add(facet, turn.scale_add(ahead, lanes(&facet.normal)), load);
        // The load's centre lies below the middle of the part.
        let below = part * (mean_s * per_rise_s).mul_add(wet - one, -(wet * wet * third));
        sum.place = sides[1].scale_add(below * straight, sum.place);
        sum.place = sides[0].scale_add(load.mul_add(ahead, below * leads * leads * bent), sum.place);
        let edge = half * per_spread * facet.area.spread();
        sum.grow(leads, edge, ahead.mul_add(-bent, depth));
        if let Some(face) = sliding {
            let rise = bent.mul_add(bent, straight.mul_add(straight, R::splat(1e-20))).sqrt();
            let load = facet.resting_load(own.up, depth, rise);
            sum.resting.add(facet, load, face.resting(facet.along(own), turning.abs()));
        }
    }
}

impl<R: Real> Leading<R> {
    #[inline(always)]
    fn none() -> Self {
        let (zero, none) = (R::zero(), Vec3::zero());
        Self {
            area: zero,
            load: zero,
            deep: zero,
            normal: none,
            squares: none,
            products: none,
            place: none,
            growth: zero,
            resting: Resting { load: zero, normal: none, place: none, slope: zero },
        }
    }

    /// Adds a plate with this mean normal and load [m³].
    #[inline(always)]
    fn add<S: Spread<R>>(&mut self, facet: &Facet<S>, normal: Vec3<R>, load: R) {
        self.load += load;
        self.normal = normal.scale_add(load, self.normal);
        self.squares.x = load.mul_add(facet.squares[0].spread(), self.squares.x);
        self.squares.y = load.mul_add(facet.squares[1].spread(), self.squares.y);
        self.products = lanes(&facet.products).scale_add(load, self.products);
        self.place = lanes(&facet.center).scale_add(load, self.place);
    }

    /// Adds the derivative with respect to n·v̂ of the load of a plate at `depth`. The share `leads` of the plate
    /// leads; `edge` is the plate's area times the derivative of that share.
    #[inline(always)]
    fn grow(&mut self, leads: R, edge: R, depth: R) {
        let (zero, one) = (R::zero(), R::one());
        let inside = R::select(leads.lt(one), edge * depth.max(zero), zero);
        self.growth += R::select(zero.lt(leads), inside, zero);
    }
}

impl<R: Real> Resting<R> {
    /// Adds a plate with the load `load` [m³] before its share.
    #[inline(always)]
    fn add<S: Spread<R>>(&mut self, facet: &Facet<S>, load: R, at: RestingShare<R>) {
        let part = load * at.share;
        self.load += part;
        self.normal = lanes(&facet.normal).scale_add(part, self.normal);
        self.place = lanes(&facet.center).scale_add(part, self.place);
        self.slope = load.mul_add(at.slope, self.slope);
    }
}

#[inline(always)]
fn lanes<R: Real, S: Spread<R>>(v: &[S; 3]) -> Vec3<R> {
    Vec3::new(v[0].spread(), v[1].spread(), v[2].spread())
}

//! `sandgait robot FILE --check`: does the robot stand, and what does standing need?

use sandgait::env::registry::Blueprint;
use sandgait::sim::tree::standing::{self, Standing};
use sandgait::sim::{Model, tree::TreeModel, tree::packed};
use sandgait::{Error, Result};
use serde_json::{Value, json};

const TASK: &str = "sandgait/LeggedVelocity-v1";
/// Where a robot stands if no ground is named: hard ground, and the densest sand with a measured law.
const GROUNDS: [&str; 2] = ["rigid", "poppy-close"];
/// Duration of a measurement of speed [s]: our choice.
const MEASURED: f64 = 0.3;

/// The sheet of a robot.
pub struct StandingReport {
    name: String,
    joints: Vec<String>,
    limits: Vec<Option<f64>>,
    plates: usize,
    dt: f64,
    needed_dt: Option<f64>,
    grounds: Vec<GroundReport>,
}

/// The robot on one ground.
struct GroundReport {
    ground: String,
    standing: Standing,
    feet: Vec<String>,
    weight: f64,
    /// Control steps a second of one thread.
    speed: f64,
}

/// A blueprint of the robot `packed` on `ground`, without randomness.
fn blueprint(packed: &str, ground: &str, dt: Option<f64>) -> Result<Blueprint> {
    let mut options = json!({"robot": packed, "ground": ground, "domain_rand": null, "angle_noise": 0.0});
    if let Some(dt) = dt {
        options["dt"] = dt.into();
    }
    Blueprint::new(TASK, options)
}

fn tree(model: &Model) -> Result<&TreeModel> {
    model.tree.as_deref().ok_or_else(|| Error::invalid("robot", "is no tree of bodies"))
}

/// A line for the beginning of a training, if `--check` asks for a finer time step than the default of the packed robot.
pub fn finer_step(packed: &str) -> Result<Option<String>> {
    if !packed::is_packed(packed) {
        return Ok(None);
    }
    let model = |dt: Option<f64>| Ok((**blueprint(packed, GROUNDS[0], dt)?.task.model()).clone());
    let usual = model(None)?.scene.dt;
    let needed = standing::needed_step(|dt| model(Some(dt)))?;
    if needed.is_some_and(|dt| dt >= usual) {
        return Ok(None);
    }
    let needed = needed.map_or("less than 0.25 ms".into(), |dt| format!("{} ms", 1e3 * dt));
    Ok(Some(format!(
        "by `sandgait robot --check` the robot needs a time step of {needed}, and the training takes {} ms: set option dt, \
         which makes it slower",
        1e3 * usual
    )))
}

impl StandingReport {
    /// The packed robot on hard ground and on `ground`, or on sand if that is None.
    pub fn of(packed: &str, ground: Option<&str>) -> Result<Self> {
        let mut names = vec![GROUNDS[0]];
        names.extend([ground.unwrap_or(GROUNDS[1])].iter().filter(|g| **g != GROUNDS[0]));
        let mut grounds = Vec::new();
        for name in names {
            let blueprint = blueprint(packed, name, None)?;
            let (model, rate) = (blueprint.task.model(), blueprint.task.spec().control_rate);
            let standing = standing::stand(model)?;
            let bodies = &tree(model)?.tree.bodies;
            let feet = standing.feet.iter().map(|f| bodies[f.body].name.clone()).collect();
            let weight = model.weight();
            let speed = standing::speed(model, rate, MEASURED)?;
            grounds.push(GroundReport { ground: name.into(), standing, feet, weight, speed });
        }
        let first = blueprint(packed, GROUNDS[0], None)?;
        let model = first.task.model();
        let robot = tree(model)?;
        let needed_dt =
            standing::needed_step(|dt| Ok((**blueprint(packed, GROUNDS[0], Some(dt))?.task.model()).clone()))?;
        Ok(Self {
            name: robot.tree.name.clone(),
            joints: model.joint_names(),
            limits: robot.motors.iter().map(|m| m.actuator.torque_limit).collect(),
            plates: robot.plates.iter().map(Vec::len).sum(),
            dt: model.scene.dt,
            needed_dt,
            grounds,
        })
    }

    /// Does the robot stand on every ground?
    pub fn stands(&self) -> bool {
        self.grounds.iter().all(|g| g.standing.stands)
    }

    /// The robot's state at the end, on the last ground.
    pub fn last_state(&self) -> Option<&sandgait::sim::State> {
        self.grounds.last().map(|g| &g.standing.state)
    }

    pub fn json(&self) -> Value {
        let ground = |g: &GroundReport| {
            let s = &g.standing;
            let feet =
                s.feet.iter().zip(&g.feet).map(
                    |(f, name)| json!({"foot": name, "sinkage": f.sinkage, "load": f.load, "pressure": f.pressure}),
                );
            let torques = s
                .torques
                .iter()
                .zip(&self.joints)
                .map(|((torque, part), name)| json!({"joint": name, "torque": torque, "part_of_limit": part}));
            json!({
                "ground": g.ground,
                "stands": s.stands,
                "reason": s.reason,
                "height": s.height[0],
                "default_height": s.height[1],
                "tilt": s.tilt,
                "weight": g.weight,
                "belly": s.belly,
                "feet": feet.collect::<Vec<_>>(),
                "joints": torques.collect::<Vec<_>>(),
                "steps_per_second": g.speed.round(),
            })
        };
        json!({
            "name": self.name,
            "stands": self.stands(),
            "plates": self.plates,
            "dt": self.dt,
            "needed_dt": self.needed_dt,
            "grounds": self.grounds.iter().map(ground).collect::<Vec<_>>(),
        })
    }

    pub fn text(&self) -> String {
        let mut text = String::new();
        for g in &self.grounds {
            let s = &g.standing;
            let verdict = if s.stands { "stands".into() } else { format!("does not stand: {}", s.reason) };
            text.push_str(&format!("{} on {}: {verdict}\n", self.name, g.ground));
            text.push_str(&format!(
                "  hips at {:.3} m ({:.3} m in the default pose), tilted by {:.1}°\n",
                s.height[0],
                s.height[1],
                s.tilt.to_degrees()
            ));
            for (foot, name) in s.feet.iter().zip(&g.feet) {
                let pressure = foot.pressure.map_or(String::new(), |p| format!(", {:.1} kPa", p / 1e3));
                let deep = 1e3 * foot.sinkage;
                text.push_str(&match foot.load == 0.0 && deep < 0.0 {
                    true => format!("  {name}: does not touch, {:.1} mm above the ground\n", -deep),
                    false => format!("  {name}: {:.1} N, {:.1} mm deep{pressure}\n", foot.load, deep.max(0.0)),
                });
            }
            text.push_str(&format!("  {}\n  {:.0} steps/s on one thread\n\n", self.hardest(s), g.speed));
        }
        let needed = match self.needed_dt {
            Some(dt) => format!("needed time step: {:.2} ms (default {:.2} ms)", 1e3 * dt, 1e3 * self.dt),
            None => format!("needed time step: below 0.25 ms (default {:.2} ms)", 1e3 * self.dt),
        };
        text.push_str(&format!("{needed}; {} plates\n", self.plates));
        text
    }

    /// The joints that need the greatest share of their torque limit, or the greatest torque if no limit is known.
    fn hardest(&self, standing: &Standing) -> String {
        let mut order: Vec<usize> = (0..self.joints.len()).collect();
        let key = |i: usize| (standing.torques[i].1.unwrap_or(0.0), standing.torques[i].0);
        order.sort_by(|a, b| key(*b).partial_cmp(&key(*a)).unwrap_or(std::cmp::Ordering::Equal));
        let one = |i: &usize| {
            let (name, (torque, part)) = (&self.joints[*i], standing.torques[*i]);
            match part.zip(self.limits[*i]) {
                Some((part, limit)) => format!("{name} {torque:.1} of {limit:.1} N·m ({:.0} %)", 100.0 * part),
                None => format!("{name} {torque:.1} N·m"),
            }
        };
        format!("torque: {}", order.iter().take(3).map(one).collect::<Vec<_>>().join(", "))
    }
}

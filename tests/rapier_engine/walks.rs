//! Walks: reference speeds, and the same walks with the engine `lanes`.

use super::*;

/// Converged speeds [m/s] at 1, 2, 3 and 5 Hz, from two independent implementations with explicit steps of 1e-5 s.
#[test]
fn walks_at_the_reference_speeds() {
    // With reversed L legs at 1 Hz, the belly sticks and slips: a change of the last bits changes the speed by 0.3 %.
    for (leg, limit, reference) in
        [("L", 0.02, [0.1201, 0.2870, 0.4161, 0.7139]), ("revL", 0.023, [0.0715, 0.1308, 0.2401, 0.4387])]
    {
        let model = model_of("xplorer", leg, &scene(), |_| ());
        let trials = [1.0, 2.0, 3.0, 5.0].map(|f| WalkTrial::new(model.clone(), f));
        for ((trial, result), reference) in trials.iter().zip(walk(&trials)).zip(reference) {
            let error = result.speed / reference - 1.0;
            assert!(error.abs() < limit, "{leg} at {} Hz: {} m/s, {error:+.4}", trial.frequency, result.speed);
            assert!((0.0..0.05).contains(&result.base_height) && result.pitch_rms < 0.5, "{result:?}");
            assert!(result.cost_of_transport > 0.1 && result.cost_of_transport < 5.0, "{result:?}");
        }
    }
}

#[test]
fn stands_still() {
    for (leg, slope_deg) in [("L", 0.0), ("revL", 0.0), ("C", 0.0), ("L", 10.0)] {
        let model = model_of("xplorer", leg, &Scene { slope_deg, ..scene() }, |_| ());
        let [result] = walk(&[WalkTrial::new(model, 0.0)])[..] else { panic!("one result") };
        assert!(result.sink.abs() < 1e-4 && result.drift < 1e-4, "{leg} at {slope_deg} deg: {result:?}");
    }
}

/// The two engines share the code of the sand and nothing else. Each simulates two seconds of walking, or of standing
/// with 18 joints, with a time step at which both have converged.
#[test]
fn agrees_with_the_engine_lanes() {
    let plain = Mechanisms::PLAIN;
    let filled = Mechanisms { concave_fill: 0.8, inertial_drag: 2.0, ..plain };
    let skids = Mechanisms { skid_loss: 0.8, graze_loss: 0.7, slip_bearing: 1.0, friction_clip: 1.8, ..plain };
    let all = [
        ("xplorer", "C", 0.0, skids),
        ("xplorer18", "flat", 10.0, plain),
        ("xplorer", "revL", 0.0, filled),
        ("xplorer", "C", 0.0, plain),
        ("xplorer", "revC", 0.0, plain),
        ("xplorer", "L", 5.0, plain),
    ];
    for (robot, leg, slope_deg, mechanisms) in long::first(3, all) {
        let scene = Scene { slope_deg, mechanisms, dt: 5e-5, ..scene() };
        let model = model_of(robot, leg, &scene, |r| r.servo.torque_limit = Some(0.02));
        let start = State::at_rest(0.03, &vec![0.0; model.joints()]);
        let command = if robot == "xplorer" { hips(&model, 2.0) } else { Command::still(18) };
        let a = run(&model, &start, &command, 2.0);
        let mut lanes = Engine::new(EngineKind::Lanes, &model, 1).unwrap();
        lanes.set_model(0, &model);
        lanes.set_state(0, &start);
        lanes.command(0, &command);
        lanes.advance((2.0 / model.scene.dt).round() as usize);
        let mut b = start.clone();
        lanes.state(0, &mut b);
        let far = V::from(b.position).norm();
        let apart = (V::from(a.position) - V::from(b.position)).norm();
        assert!(apart < 0.01 * far, "{robot} {leg}: {:?} {:?}", a.position, b.position);
        // 10 µJ is small: a robot that settles does 130 µJ of work, one that walks 0.4 J.
        assert!((a.work - b.work).abs() < 0.02 * b.work + 1e-5, "{robot} {leg}: work {} {}", a.work, b.work);
    }
}

#[test]
fn parallel_walks_equal_single_walks_and_wrong_ones_are_refused() {
    let model = |leg: &str| model_of("xplorer", leg, &scene(), |_| ());
    let trials =
        [WalkTrial::new(model("L"), 5.0), WalkTrial::new(model("revL"), 3.0), WalkTrial::new(model("L"), -5.0)];
    let together = walk(&trials);
    for (trial, result) in trials.iter().zip(&together) {
        assert_eq!(walk(std::slice::from_ref(trial))[0], *result);
    }
    assert!(together[2].speed < 0.0);
    let refused = |trial: WalkTrial| walk_many(EngineKind::Rapier, &[trial], &|_| Ok(())).is_err();
    assert!(refused(WalkTrial::new(model("L"), f64::NAN)));
    assert!(refused(WalkTrial::new(model("L"), 1e-9)));
    assert!(refused(WalkTrial::new(model_of("xplorer18", "flat", &scene(), |_| ()), 1.0)));
    assert!(walk_many(EngineKind::Rapier, &[], &|_| Ok(())).unwrap().is_empty());
}

//! Uneven ground.

use sandgait_sim::tree::relief::*;

#[test]
fn a_plane_is_a_plane() {
    let rows: Vec<Vec<f64>> = (0..8).map(|j| (0..9).map(|i| 0.1 * i as f64 - 0.05 * j as f64).collect()).collect();
    let plane = Relief::new(0.5, &rows).unwrap();
    for (x, y) in [(1.0, 1.0), (1.3, 2.24), (2.9, 0.77)] {
        let (height, [gx, gy]) = plane.at(x, y);
        assert!((height - (0.2 * x - 0.1 * y)).abs() < 1e-7);
        assert!((gx - 0.2).abs() < 1e-6 && (gy + 0.1).abs() < 1e-6);
    }
    // Beyond its edges the surface continues at the height of the edge.
    assert!(plane.at(1e9, 1.0).1[0].abs() < 1e-9 && plane.at(f64::MAX, -f64::MAX).0.is_finite());
}

#[test]
fn dunes_are_as_steep_as_asked_and_come_again() {
    let dunes = Relief::dunes(3, 2.0, 20.0).unwrap();
    assert!((dunes.steepest().0 - 20f64.to_radians().tan()).abs() < 1e-5);
    let [length, _] = dunes.size();
    assert!((length - 16.0).abs() < 1e-9);
    assert!((dunes.at(1.234, 5.6).0 - dunes.at(1.234 - length, 5.6 + length).0).abs() < 1e-6);
    assert_ne!(dunes, Relief::dunes(4, 2.0, 20.0).unwrap());
    assert!(Relief::dunes(3, 2.0, 36.0).is_err());
    let cliff: Vec<Vec<f64>> = (0..8).map(|j| vec![if j < 4 { 0.0 } else { 1.0 }; 8]).collect();
    assert!(Relief::new(0.5, &cliff).unwrap().check_repose().unwrap_err().to_string().contains("steep"));
}

//! Packed heights.

use base64::prelude::{BASE64_STANDARD, Engine as _};
use sandgait_sim::tree::heights::*;
use std::io::Write as _;

#[test]
fn heights_come_back_to_a_tenth_of_a_millimetre() {
    let height = |j: usize, i: usize| 3.0 * (0.05 * i as f64).sin() - 50.0 + 0.3 * (0.11 * j as f64).cos();
    let rows: Vec<Vec<f64>> = (0..300).map(|j| (0..200).map(|i| height(j, i)).collect()).collect();
    let text = pack(&rows).unwrap();
    assert!(text.len() < 100_000, "{}", text.len());
    let back = unpack(&text).unwrap();
    assert_eq!((back.len(), back[0].len()), (300, 200));
    for (a, b) in rows.iter().flatten().zip(back.iter().flatten()) {
        assert!((a - b).abs() <= 0.51e-4);
    }
    let edges = vec![vec![-100.0, 100.0, -100.0, 100.0], vec![100.0; 4], vec![-100.0; 4], vec![0.0; 4]];
    assert_eq!(unpack(&pack(&edges).unwrap()).unwrap(), edges);
}

#[test]
fn broken_texts_are_refused() {
    let packed = |bytes: &[u8]| {
        let mut stream = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
        stream.write_all(bytes).unwrap();
        format!("{MARK}{}", BASE64_STANDARD.encode(stream.finish().unwrap()))
    };
    let bomb = packed(&[&[255, 255, 255, 255][..], &vec![0; 50 << 20]].concat());
    let long = packed(&[&[4, 0, 4, 0][..], &[0; 17]].concat());
    let wide = packed(&[&[4, 0, 4, 0][..], &[255; 200]].concat());
    for text in [
        "heights:",
        "heights:!!",
        "heights:AAAA",
        &packed(&[4, 0, 4, 0, 0]),
        &packed(&[4, 0, 0, 0]),
        &bomb,
        &long,
        &wide,
    ] {
        let error = unpack(text).unwrap_err().to_string();
        assert!(error.starts_with("relief.file: not packed heights"), "{error}");
    }
    // Largest differences everywhere: the heights are refused later, and nothing overflows.
    let most = [4_u8, 0, 4, 0].into_iter().chain([254, 255, 255, 255, 127].repeat(16)).collect::<Vec<_>>();
    assert!(unpack(&packed(&most)).unwrap().iter().flatten().all(|h| h.is_finite()));
    let rough = |k: u32| {
        let mixed = (k ^ (k >> 7)).wrapping_mul(2_654_435_761);
        f64::from((mixed ^ (mixed >> 15)).wrapping_mul(2_246_822_507) >> 16) * 1e-3
    };
    let rough: Vec<Vec<f64>> = (0..512).map(|j| (0..512).map(|i| rough(512 * j + i)).collect()).collect();
    assert!(pack(&rough).unwrap_err().to_string().contains("fewer"));
}

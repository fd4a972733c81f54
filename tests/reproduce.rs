//! The reproduction of the paper's figures and claims: it is complete, and its results do not change by accident.

use resvg::tiny_skia;
use sandgait::plot::png;
use sandgait::reproduce::{self, ClaimVerdict, FIGURES};

#[test]
fn claims_are_complete_and_reproducible() {
    let [first, second] = [(); 2].map(|()| reproduce::compute(&FIGURES).unwrap());
    let json = |parts: &[reproduce::FigureSection]| {
        serde_json::to_string(&parts.iter().flat_map(|p| &p.claims).collect::<Vec<_>>()).unwrap()
    };
    assert_eq!(json(&first), json(&second), "claims differ between two runs");
    let claims: Vec<_> = first.iter().flat_map(|p| &p.claims).collect();
    let verdict = |id: &str| claims.iter().find(|c| c.id == id).unwrap_or_else(|| panic!("no claim {id}")).verdict;
    let mut ids: Vec<_> = claims.iter().map(|c| &c.id).collect();
    ids.sort();
    ids.dedup();
    assert_eq!(ids.len(), claims.len(), "two claims share an id");
    for c in &claims {
        assert!(![&c.claim, &c.seed_value, &c.ours, &c.why].iter().any(|t| t.is_empty() || t.contains("NaN")), "{c:?}");
    }
    // Claims that follow from the equations alone.
    for id in ["3.1d_disagrees", "4.l_faster", "5.positive_faster_1hz", "5.positive_faster_4hz", "4.cost"] {
        assert_eq!(verdict(id), ClaimVerdict::Reproduced, "{id}");
    }
    // Claims that do not follow from the stated equations. If one of them were reproduced, the model would have been tuned to it.
    assert_eq!(verdict("3.1d_drag_reversed"), ClaimVerdict::NotReproduced);
    // Claims that need the paper's measured curves, which are not public.
    for id in ["3.rft_agreement", "4.speed_within_15", "4.speed_within_30", "5.within_10_50", "5.within_30_50"] {
        assert_eq!(verdict(id), ClaimVerdict::NoData, "{id}");
    }
}

#[test]
fn all_files_are_written() {
    let folder = tempfile::tempdir().unwrap();
    reproduce::write(&reproduce::compute(&[2]).unwrap(), folder.path()).unwrap();
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    let report = String::from_utf8(read("report.html")).unwrap();
    assert!(report.contains("<svg") && !report.contains("src=") && !report.contains("href="), "not self-contained");
    assert!(read("figure2.png").starts_with(b"\x89PNG"));
    assert!(serde_json::from_slice::<serde_json::Value>(&read("claims.json")).unwrap().as_array().unwrap().len() > 4);
    assert!(reproduce::compute(&[6]).is_err());
}

/// Figures show their letters at the right place, and no two letters have the same picture. (The font is compiled in.)
#[test]
fn figures_have_letters() {
    let page = |text: &str| {
        let svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"120\" height=\"30\"><text x=\"10\" y=\"20\" font-size=\"12\" font-family=\"DejaVu Sans\">{text}</text></svg>"
        );
        tiny_skia::Pixmap::decode_png(&png::encode(&svg).unwrap()).unwrap()
    };
    // Columns and rows of the dark pixels, at two pixels a unit.
    let ink = |text: &str| -> Vec<(u32, u32)> {
        let map = page(text);
        assert_eq!((map.width(), map.height()), (240, 60));
        let drawn = map.pixels().iter().enumerate().filter(|(_, p)| p.alpha() > 127);
        drawn.map(|(i, _)| (i as u32 % 240, i as u32 / 240)).collect()
    };
    assert_eq!(ink(""), []);
    let letters: Vec<_> = "αβγξζ".chars().map(|c| ink(&c.to_string())).collect();
    // All letters that the font lacks would have the same picture, a box.
    let missing = ink("\u{10ffff}");
    for (k, letter) in letters.iter().enumerate() {
        assert!(letter.len() > 20, "letter {k}: {} pixels", letter.len());
        // The baseline is at y = 20; letters are 12 high and reach 4 below it; the text begins at x = 10.
        assert!(letter.iter().all(|(x, y)| (20..50).contains(x) && (14..50).contains(y)), "letter {k} lies elsewhere");
        assert!(*letter != missing && letters[..k].iter().all(|other| other != letter), "letter {k} is like another");
    }
    let word = ink("αβγξζ");
    let width = word.iter().map(|p| p.0).max().unwrap() - word.iter().map(|p| p.0).min().unwrap();
    assert!((50..100).contains(&width), "five letters are {width} pixels wide");
}

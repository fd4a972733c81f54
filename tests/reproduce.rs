//! The paper's figures and claims, from the library: complete, stable, and the facts that must come out.

use sandgait::plot::png;
use sandgait::reproduce::{self, FIGURES, Verdict};

#[test]
fn claims_are_complete_honest_and_stable() {
    let [first, second] = [(); 2].map(|()| reproduce::compute(&FIGURES).unwrap());
    let json = |parts: &[reproduce::Part]| {
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
    // What follows from the physics, whatever the paper measured.
    for id in ["3.1d_disagrees", "4.l_faster", "5.positive_faster_1hz", "5.positive_faster_4hz", "4.cost"] {
        assert_eq!(verdict(id), Verdict::Reproduced, "{id}");
    }
    // What no reading of the stated equations gives: a change here means that something was bent.
    assert_eq!(verdict("3.1d_drag_reversed"), Verdict::NotReproduced);
    // The paper's measured curves are public nowhere.
    for id in ["3.rft_agreement", "4.speed_within_15", "4.speed_within_30", "5.within_10_50", "5.within_30_50"] {
        assert_eq!(verdict(id), Verdict::NoData, "{id}");
    }
}

#[test]
fn files_are_all_there() {
    let folder = tempfile::tempdir().unwrap();
    reproduce::write(&reproduce::compute(&[2]).unwrap(), folder.path()).unwrap();
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    let report = String::from_utf8(read("report.html")).unwrap();
    assert!(report.contains("<svg") && !report.contains("src=") && !report.contains("href="), "not self-contained");
    assert!(read("figure2.png").starts_with(b"\x89PNG"));
    assert!(serde_json::from_slice::<serde_json::Value>(&read("claims.json")).unwrap().as_array().unwrap().len() > 4);
    assert!(reproduce::compute(&[6]).is_err());
}

/// The font is compiled in: a figure with letters has more ink than the same one without.
#[test]
fn figures_have_letters() {
    let page = |text: &str| {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"90\" height=\"30\"><text y=\"20\" font-family=\"DejaVu Sans\">{text}</text></svg>"
        )
    };
    let [with, without] = [page("αβγξζ"), page("")].map(|svg| png::encode(&svg).unwrap().len());
    assert!(with > without + 300, "{with} {without}");
}

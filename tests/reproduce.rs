//! The reproduction of the paper's figures and claims: it is complete, and its results do not change by accident.

use sandgait::progress::Silent;
use sandgait::reproduce::{self, ClaimVerdict, FIGURES};

#[test]
fn claims_are_complete_and_reproducible() {
    let [first, second] = [(); 2].map(|()| reproduce::compute(&FIGURES, &Silent).unwrap());
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
    let files = reproduce::files(&reproduce::compute(&[2], &Silent).unwrap()).unwrap();
    let read = |name: &str| files.iter().find(|(file, _)| file == name).unwrap().1.as_str();
    let report = read("report.html");
    assert!(report.contains("<svg") && !report.contains("src=") && !report.contains("href="), "not self-contained");
    assert!(read("figure2.svg").starts_with("<svg"));
    assert!(serde_json::from_str::<serde_json::Value>(read("claims.json")).unwrap().as_array().unwrap().len() > 4);
    assert!(reproduce::compute(&[6], &Silent).is_err());
}

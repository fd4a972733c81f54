//! Tags of snapshots.

use sandgait::pool::Seal;

/// RFC 4231, test case 1.
#[test]
fn the_published_value() {
    let seal = Seal::new(&[0x0b; 20]).unwrap();
    let tag: String = seal.tag(b"Hi There").iter().map(|b| format!("{b:02x}")).collect();
    assert_eq!(tag, "b0344c61d8db38535ca8afceaf0bf12b881dc200c9833da726e9376c2e32cff7");
}

#[test]
fn only_the_key_makes_a_seal() {
    let (ours, theirs, none) = (Seal::new(&[1; 16]).unwrap(), Seal::new(&[2; 16]).unwrap(), Seal::default());
    let data = b"data";
    for seal in [&ours, &theirs, &none] {
        assert_eq!(seal.check(&seal.tag(data), data), Ok(()));
        assert!(seal.check(&seal.tag(data), b"Data").is_err());
    }
    assert!(ours.check(&theirs.tag(data), data).unwrap_err().starts_with("its seal is wrong"));
    assert!(ours.check(&none.tag(data), data).unwrap_err().starts_with("it has no seal"));
    assert!(none.check(&ours.tag(data), data).unwrap_err().starts_with("it is damaged, or sealed"));
    assert!(Seal::new(&[1; 15]).is_none());
}

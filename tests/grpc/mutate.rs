//! Random changes of valid messages.

use rand::Rng;

/// Numbers at the ends of ranges, as encoded in messages.
const EDGES: [&[u8]; 8] = [
    &[0],
    &[0xff; 4],
    &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01],
    &[0x80; 12],
    &[0, 0, 0x80, 0x7f],
    &[0, 0, 0xc0, 0x7f],
    &[0, 0, 0, 0, 0, 0, 0xf0, 0xff],
    b"\xf0\x9f\xa6\x97",
];

/// `message` with one to four changes: bits, bytes, edges, parts left out, doubled, moved, or taken from `other`.
pub fn mutated(random: &mut impl Rng, message: &[u8], other: &[u8]) -> Vec<u8> {
    let mut bytes = message.to_vec();
    for _ in 0..random.random_range(1..=4) {
        let at = random.random_range(0..=bytes.len());
        let end = random.random_range(at..=bytes.len().min(at + 24));
        match random.random_range(0..8) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.random_range(0..8),
            1 if at < bytes.len() => bytes[at] = random.random(),
            2 => drop(bytes.splice(at..end, EDGES[random.random_range(0..EDGES.len())].iter().copied())),
            3 => drop(bytes.drain(at..end)),
            4 => {
                let part = bytes[at..end].to_vec();
                drop(bytes.splice(at..at, part));
            }
            5 => bytes.truncate(at),
            6 if !other.is_empty() => {
                let from = random.random_range(0..other.len());
                let to = random.random_range(from..other.len().min(from + 64));
                drop(bytes.splice(at..end, other[from..to].iter().copied()));
            }
            _ => bytes[at..end].reverse(),
        }
    }
    bytes
}

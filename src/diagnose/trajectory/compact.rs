//! A reader of Thrift's compact protocol (Apache Thrift, thrift-compact-protocol.md), in which Parquet writes its headers. It reads
//! only the fields that give sizes and counts, so that they can be checked before anything is decompressed. Every function returns
//! `None` if the value would reach beyond the bytes.

/// Largest depth of nested structs: our choice; those of Parquet are three deep.
const DEEPEST: usize = 16;

pub struct Compact<'a> {
    pub bytes: &'a [u8],
    pub at: usize,
}

/// Integers of a struct by field number; the first is field 1.
pub type Numbers = [Option<i64>; 8];

impl Compact<'_> {
    /// Integers and Booleans of a struct.
    pub fn table(&mut self) -> Option<Numbers> {
        let mut own = [None; 8];
        let mut id = 0;
        while let Some(kind) = self.field(&mut id)? {
            match (id, kind) {
                (1..=8, 4..=6) => own[id as usize - 1] = Some(self.signed()?),
                (1..=8, 1 | 2) => own[id as usize - 1] = Some(i64::from(kind == 1)),
                _ => self.skip(kind, 0)?,
            }
        }
        Some(own)
    }

    fn byte(&mut self) -> Option<u8> {
        let byte = *self.bytes.get(self.at)?;
        self.at += 1;
        Some(byte)
    }

    pub fn unsigned(&mut self) -> Option<u64> {
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    pub fn signed(&mut self) -> Option<i64> {
        let value = self.unsigned()?;
        Some((value >> 1).cast_signed() ^ -((value & 1).cast_signed()))
    }

    fn over(&mut self, count: u64) -> Option<()> {
        let next = self.at.checked_add(usize::try_from(count).ok()?)?;
        self.at = next;
        (next <= self.bytes.len()).then_some(())
    }

    /// Type of the next field; its number is written to `id`. `Some(None)` at the end of the struct.
    pub fn field(&mut self, id: &mut i64) -> Option<Option<u8>> {
        let byte = self.byte()?;
        if byte == 0 {
            return Some(None);
        }
        *id = match i64::from(byte >> 4) {
            0 => self.signed()?,
            more => id.checked_add(more)?,
        };
        Some(Some(byte & 0x0f))
    }

    /// Type and number of a list's elements.
    pub fn list(&mut self) -> Option<(u8, u64)> {
        let head = self.byte()?;
        let count = if head >> 4 == 15 { self.unsigned()? } else { u64::from(head >> 4) };
        Some((head & 0x0f, count))
    }

    pub fn skip(&mut self, kind: u8, depth: usize) -> Option<()> {
        if depth > DEEPEST {
            return None;
        }
        match kind {
            1 | 2 => Some(()),
            3 => self.over(1),
            4..=6 => self.unsigned().map(drop),
            7 => self.over(8),
            8 => {
                let length = self.unsigned()?;
                self.over(length)
            }
            9 | 10 => {
                let (kind, count) = self.list()?;
                self.elements(&[kind], count, depth)
            }
            11 => match self.unsigned()? {
                0 => Some(()),
                count => {
                    let kinds = self.byte()?;
                    self.elements(&[kinds >> 4, kinds & 0x0f], count, depth)
                }
            },
            12 => {
                let mut id = 0;
                while let Some(kind) = self.field(&mut id)? {
                    self.skip(kind, depth + 1)?;
                }
                Some(())
            }
            _ => None,
        }
    }

    fn elements(&mut self, kinds: &[u8], count: u64, depth: usize) -> Option<()> {
        // Each element has at least one byte.
        if count > self.bytes.len() as u64 {
            return None;
        }
        for _ in 0..count {
            for kind in kinds {
                // In a list, a Boolean is one byte; as a field, it is part of the type.
                if matches!(kind, 1 | 2) { self.over(1)? } else { self.skip(*kind, depth + 1)? }
            }
        }
        Some(())
    }
}

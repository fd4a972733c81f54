//! Columns of a log: one line each gives its place, name, quantity, and whether a log must have it.

/// `COLUMNS`, and a constant with its place for each. `Column` and `Quantity` stand where it is used.
macro_rules! columns {
    ($($place:ident = $name:literal $quantity:ident $required:literal;)*) => {
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)]
        enum Place { $($place),* }
        const COLUMNS: &[Column] =
            &[$(Column { name: $name, quantity: Quantity::$quantity, required: $required }),*];
        $(const $place: usize = Place::$place as usize;)*
    };
}
pub(crate) use columns;

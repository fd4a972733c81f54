//! Columns of a log: one line each declares name, quantity, and whether a log must have it.

/// Defines `COLUMNS`, and a constant with the index of each column. The calling file must have `HeaderColumn` and
/// `Quantity` in scope.
macro_rules! columns {
    ($($place:ident = $name:literal $quantity:ident $required:literal;)*) => {
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)]
        enum Index { $($place),* }
        const COLUMNS: &[HeaderColumn] =
            &[$(HeaderColumn { name: $name, quantity: Quantity::$quantity, required: $required }),*];
        $(const $place: usize = Index::$place as usize;)*
    };
}
pub(crate) use columns;

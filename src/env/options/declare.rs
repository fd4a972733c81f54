//! The macro that declares options.

/// Declares a struct of options; [`crate::options`] shows how, one line for each option:
/// `name: Type = default, [low, high], reset, "help";`, where bounds and `reset` may be missing. `[RANGE]` are bounds
/// that stand elsewhere. Bounds for which a struct gives no reason are our choice: far beyond useful values, they catch
/// wrong units.
#[macro_export]
macro_rules! options {
    (
        $(#[$meta:meta])*
        pub struct $Name:ident {
            $(..$base:ident: $Base:ty = $base_default:expr;)?
            $($field:ident: $type:ty = $default:expr, $([$($bound:expr),+],)? $($reset:ident,)? $help:literal;)*
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $Name {
            $(pub $base: $Base,)?
            $(#[doc = $help] pub $field: $type,)*
        }

        impl Default for $Name {
            fn default() -> Self {
                Self { $($base: $base_default,)? $($field: $default,)* }
            }
        }

        impl $crate::options::Options for $Name {
            fn rows() -> Vec<$crate::options::OptionRow> {
                let own = vec![$($crate::options::OptionRow {
                    name: stringify!($field),
                    help: $help,
                    at_reset: $crate::options!(@reset $($reset)?),
                    bounds: $crate::options!(@bounds $([$($bound),+])?),
                    is_range: <$type as $crate::options::OptionValue>::IS_RANGE,
                    keys: <$type as $crate::options::OptionValue>::keys(),
                },)*];
                $(if true { return [<$Base as $crate::options::Options>::rows(), own].concat(); })?
                own
            }

            fn get(&self, name: &str) -> Option<serde_json::Value> {
                $(if let Some(value) = $crate::options::Options::get(&self.$base, name) {
                    return Some(value);
                })?
                match name {
                    $(stringify!($field) => serde_json::to_value(&self.$field).ok(),)*
                    _ => None,
                }
            }

            fn set(&mut self, name: &str, value: &serde_json::Value) -> $crate::error::Result<bool> {
                $(if $crate::options::Options::set(&mut self.$base, name, value)? {
                    return Ok(true);
                })?
                Ok(match name {
                    $(stringify!($field) => {
                        self.$field = $crate::options::changed(stringify!($field), &self.$field, value)?;
                        true
                    })*
                    _ => false,
                })
            }

            fn count_memory(&self, count: &mut $crate::options::MemoryCount) {
                $($crate::options::Options::count_memory(&self.$base, count);)?
                $($crate::options::OptionValue::count_memory(&self.$field, count);)*
            }

            fn check_all(&self, prefix: &str) -> $crate::error::Result<()> {
                $($crate::options::Options::check_all(&self.$base, prefix)?;)?
                $($crate::options!(@check self.$field, &format!("{prefix}{}", stringify!($field)), $([$($bound),+])?);)*
                Ok(())
            }
        }

        /// The struct as a dictionary among other options.
        impl $crate::options::OptionValue for $Name {
            fn count_memory(&self, count: &mut $crate::options::MemoryCount) {
                $crate::options::Options::count_memory(self, count);
            }

            fn check(&self, name: &str) -> $crate::error::Result<()> {
                $crate::options::Options::check_all(self, &format!("{name}."))
            }

            fn keys() -> Vec<$crate::options::OptionRow> {
                <Self as $crate::options::Options>::rows()
            }
        }
    };
    (@reset reset) => { true };
    (@reset) => { false };
    (@check $value:expr, $name:expr, [$low:expr, $high:expr]) => {
        $crate::options::Bounded::within(&$value, $name, $low..=$high)?
    };
    (@check $value:expr, $name:expr, [$range:expr]) => {
        $crate::options::Bounded::within(&$value, $name, $range)?
    };
    (@bounds) => { None };
    (@bounds [$low:expr, $high:expr]) => { Some([$low, $high]) };
    (@bounds [$range:expr]) => { Some([*$range.start(), *$range.end()]) };
    (@check $value:expr, $name:expr,) => { $crate::options::OptionValue::check(&$value, $name)? };
}

//! Terms of a reward, each declared once with name, default weight, description and function.

/// Declares the terms of a reward and the option that weights them, one line for each term:
/// `name: default weight, "what it is", function of the step;`.
#[macro_export]
macro_rules! reward_terms {
    (
        $(#[$meta:meta])*
        pub struct $Name:ident of $Step:ty, weights in [$low:expr, $high:expr] {
            $($term:ident: $weight:expr, $law:literal, $value:expr;)*
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $Name {
            $(#[doc = $law] pub $term: f64,)*
        }

        impl Default for $Name {
            fn default() -> Self {
                Self { $($term: $weight,)* }
            }
        }

        impl $Name {
            /// In the order of the info columns.
            pub fn terms(&self) -> Vec<$crate::spec::RewardTerm> {
                vec![$($crate::spec::RewardTerm { name: stringify!($term), law: $law, weight: self.$term },)*]
            }

            /// Fills `row` with each term of `step` times its weight and `scale`.
            pub fn fill(&self, step: &$Step, scale: f64, row: &mut [f32]) {
                let values: &[fn(&$Step) -> f64] = &[$($value,)*];
                let weights = [$(self.$term,)*];
                for ((out, value), weight) in row.iter_mut().zip(values).zip(weights) {
                    *out = (value(step) * weight * scale) as f32;
                }
            }
        }

        impl $crate::options::OptionValue for $Name {
            fn count_memory(&self, _count: &mut $crate::options::MemoryCount) {}

            fn check(&self, name: &str) -> $crate::error::Result<()> {
                $($crate::options::Bounded::within(
                    &self.$term,
                    &format!("{name}.{}", stringify!($term)),
                    $low..=$high,
                )?;)*
                Ok(())
            }
        }
    };
}

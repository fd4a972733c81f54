//! Stores results, because they may be needed again.

use super::forward::SandParameters;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// The last results, each with the inputs from which it was computed. A clone starts without results, because they would be
/// wrong if the clone's owner then changes.
pub struct Recent<K, T> {
    results: Mutex<Vec<(K, Arc<T>)>>,
    most: usize,
}

impl<K, T> Clone for Recent<K, T> {
    fn clone(&self) -> Self {
        Self::up_to(self.most)
    }
}

impl<K, T> Recent<K, T> {
    /// Keeps `most` results; `most` must be at least 2.
    pub fn up_to(most: usize) -> Self {
        Self { results: Mutex::default(), most }
    }
}

impl<K: Clone + PartialEq, T> Recent<K, T> {
    pub fn known(&self, key: &K) -> Option<Arc<T>> {
        let known = self.results.lock().unwrap_or_else(PoisonError::into_inner);
        known.iter().find(|k| k.0 == *key).map(|k| k.1.clone())
    }

    /// The result for `key`, computed if it is not known. Other threads wait during the computation, because they usually
    /// need the same result.
    pub fn of(&self, key: &K, compute: impl FnOnce() -> T) -> Arc<T> {
        let mut known = self.results.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, result)) = known.iter().find(|k| k.0 == *key) {
            return result.clone();
        }
        let result = Arc::new(compute());
        // The first result, usually the plain model's, stays, because it is needed most often.
        if known.len() == self.most {
            known.remove(1);
        }
        known.push((key.clone(), result.clone()));
        result
    }
}

/// Stores all results by the bits of their inputs.
pub struct Known<T> {
    results: Mutex<HashMap<Vec<u64>, T>>,
    /// If there are this many results, all are forgotten.
    most: usize,
}

/// The bits of a sand and of other numbers.
pub fn key((mechanisms, coefficients): &SandParameters, others: &[f64]) -> Vec<u64> {
    let numbers = mechanisms.values().into_iter().chain(coefficients.to_array());
    numbers.chain(others.iter().copied()).map(f64::to_bits).collect()
}

impl<T> Known<T> {
    pub fn up_to(most: usize) -> Self {
        Self { results: Mutex::default(), most }
    }
}

impl<T: Clone> Known<T> {
    /// The result of each key. `compute` gets the places of the keys that are new, each once.
    pub fn of(&self, keys: Vec<Vec<u64>>, compute: impl FnOnce(&[usize]) -> Vec<T>) -> Vec<T> {
        let known = || self.results.lock().unwrap_or_else(PoisonError::into_inner);
        // Copied at once, because another thread may make the store forget its results during the computation.
        let mut own: HashMap<&[u64], T> = {
            let known = known();
            keys.iter().filter_map(|key| Some((key.as_slice(), known.get(key)?.clone()))).collect()
        };
        let is_new = |k: &usize| !own.contains_key(keys[*k].as_slice()) && !keys[..*k].contains(&keys[*k]);
        let new: Vec<usize> = (0..keys.len()).filter(is_new).collect();
        own.extend(new.iter().map(|&k| keys[k].as_slice()).zip(compute(&new)));
        let mut known = known();
        for &k in &new {
            if known.len() >= self.most {
                known.clear();
            }
            known.insert(keys[k].clone(), own[keys[k].as_slice()].clone());
        }
        keys.iter().map(|key| own[key.as_slice()].clone()).collect()
    }
}

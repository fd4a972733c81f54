//! Parts of the memory for requests.

use crate::error::{Error, Result};
use parking_lot::Mutex;
use tokio::sync::OwnedSemaphorePermit;

/// Unit of shares [bytes]: our choice, because a semaphore takes its permits as `u32`, and bytes would end at 4 GiB.
pub const UNIT: usize = 1 << 10;

/// Part of the memory for requests. Dropping it releases the memory.
pub struct Share {
    permit: Mutex<OwnedSemaphorePermit>,
    room: usize,
}

impl Share {
    /// `room`: the memory for all requests [bytes].
    pub fn new(permit: OwnedSemaphorePermit, room: usize) -> Self {
        Self { permit: Mutex::new(permit), room }
    }

    pub fn bytes(&self) -> usize {
        self.permit.lock().num_permits() * UNIT
    }

    /// Takes `bytes` more, if so many are free now.
    pub fn grow(&self, bytes: usize) -> Result<()> {
        let mut permit = self.permit.lock();
        let more = permit.semaphore().clone().try_acquire_many_owned(units(bytes)).map_err(|_| {
            let room = self.room >> 20;
            Error::Exhausted(format!("needs more than is left of the {room} MiB that requests may take"))
        })?;
        permit.merge(more);
        Ok(())
    }
}

/// `bytes` in units of shares.
pub fn units(bytes: usize) -> u32 {
    u32::try_from(bytes.div_ceil(UNIT)).unwrap_or(u32::MAX)
}

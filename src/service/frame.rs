//! A request as it arrived: bytes that are not unpacked yet.

use super::intake::{Door, Share};
use super::wire::{self, MessageLayout};
use super::{off_runtime, status};
use crate::error::{Error, Result};
use bytes::{Buf as _, Bytes};
use prost::Message;
use std::marker::PhantomData;
use tonic::codec::{BufferSettings, Codec, DecodeBuf, Decoder};
use tonic::{Request, Status};
use tonic_prost::{ProstCodec, ProstEncoder};

/// The bytes of a message `T`. Empty for a large one, which is in the call's [`Door`].
pub struct Frame<T>(Bytes, PhantomData<fn() -> T>);

/// Largest request [bytes] that is unpacked on the thread that received it: some 0.3 ms at worst.
const LIGHT: usize = 16 << 10;

impl<T: Message + Default + 'static> Frame<T> {
    /// The message, with its share of the memory for requests. Its parts are counted before any is unpacked.
    pub fn open(self, door: &Door, layout: MessageLayout) -> Result<(T, Option<Share>)> {
        let (bytes, share) = door.take(self.0);
        Ok((unpacked(bytes, layout)?, share))
    }

    /// The same as [`Self::receive`] for a call with a single message.
    pub async fn only(
        request: Request<Self>,
        layout: MessageLayout,
    ) -> std::result::Result<(T, Option<Share>), Status> {
        let door = Door::of(&request);
        request.into_inner().receive(&door, layout).await
    }

    /// The same as [`Self::open`]; large messages are unpacked on another thread than the async runtime's.
    pub async fn receive(self, door: &Door, layout: MessageLayout) -> std::result::Result<(T, Option<Share>), Status> {
        let (bytes, share) = door.take(self.0);
        let message = if bytes.len() <= LIGHT {
            unpacked(bytes, layout).map_err(|e| status::status(&e))?
        } else {
            off_runtime(move || unpacked(bytes, layout)).await?
        };
        Ok((message, share))
    }
}

fn unpacked<T: Message + Default>(bytes: Bytes, layout: MessageLayout) -> Result<T> {
    wire::check(&bytes, layout)?;
    T::decode(bytes).map_err(|e| Error::invalid("message", format!("cannot be read: {e}")))
}

/// Takes requests as frames and writes answers as protobuf.
pub struct FrameCodec<T, U>(PhantomData<fn() -> (T, U)>);

impl<T, U> Default for FrameCodec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T: Message + Send + 'static, U: 'static> Codec for FrameCodec<T, Frame<U>> {
    type Encode = T;
    type Decode = Frame<U>;
    type Encoder = ProstEncoder<T>;
    type Decoder = FrameDecoder<U>;

    fn encoder(&mut self) -> Self::Encoder {
        ProstCodec::<T, ()>::raw_encoder(BufferSettings::default())
    }

    fn decoder(&mut self) -> Self::Decoder {
        FrameDecoder(PhantomData)
    }
}

pub struct FrameDecoder<U>(PhantomData<fn() -> U>);

impl<U> Decoder for FrameDecoder<U> {
    type Item = Frame<U>;
    type Error = Status;

    fn decode(&mut self, bytes: &mut DecodeBuf<'_>) -> std::result::Result<Option<Self::Item>, Status> {
        Ok(Some(Frame(bytes.copy_to_bytes(bytes.remaining()), PhantomData)))
    }
}

//! A request as it arrived: bytes that are not unpacked yet.

use super::fields::SMALL;
use super::intake::Messages;
use super::share::Share;
use super::{off_runtime, status};
use crate::error::{Error, Result};
use bytes::{Buf as _, Bytes};
use prost::Message;
use std::marker::PhantomData;
use tonic::Status;
use tonic::codec::{BufferSettings, Codec, DecodeBuf, Decoder};
use tonic_prost::{ProstCodec, ProstEncoder};

/// The bytes of a message `T` that is not unpacked yet.
pub struct RequestFrame<T>(Bytes, PhantomData<fn() -> T>);

impl<T: Message + Default + 'static> RequestFrame<T> {
    /// The message of a call that has only one, with its share of the memory for requests.
    pub async fn only(request: tonic::Request<Self>) -> std::result::Result<(T, Option<Share>), Status> {
        let messages = Messages::of(&request);
        request.into_inner().open(&messages).await
    }

    /// The message, with its share. Its parts are counted before any is unpacked. A message of at most [`SMALL`] is
    /// unpacked on this thread, which takes 0.3 ms at worst; a larger one is unpacked on a blocking thread.
    pub async fn open(self, messages: &Messages) -> std::result::Result<(T, Option<Share>), Status> {
        let (bytes, share) = (self.0, messages.take_share());
        let layout = messages.layout();
        let unpack = move |bytes: Bytes| -> Result<T> {
            layout.map_or(Ok(()), |layout| layout.check(&bytes))?;
            T::decode(bytes).map_err(|e| Error::invalid("message", format!("cannot be read: {e}")))
        };
        let message = match bytes.len() <= SMALL {
            true => unpack(bytes).map_err(|e| status::status(&e))?,
            false => off_runtime(move || unpack(bytes)).await?,
        };
        Ok((message, share))
    }
}

/// Takes requests as frames and writes answers as protobuf.
pub struct FrameCodec<T, U>(PhantomData<fn() -> (T, U)>);

impl<T, U> Default for FrameCodec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T: Message + Send + 'static, U: 'static> Codec for FrameCodec<T, RequestFrame<U>> {
    type Encode = T;
    type Decode = RequestFrame<U>;
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
    type Item = RequestFrame<U>;
    type Error = Status;

    fn decode(&mut self, bytes: &mut DecodeBuf<'_>) -> std::result::Result<Option<Self::Item>, Status> {
        Ok(Some(RequestFrame(bytes.copy_to_bytes(bytes.remaining()), PhantomData)))
    }
}

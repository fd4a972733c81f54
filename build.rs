//! Compiles the protos in pure Rust: no protoc is needed.

use prost::Message as _;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=proto");
    let ours = ["proto/sandgait/v1/sandgait.proto", "proto/sandgait/v1/studies.proto"];
    let files = protox::compile(ours.iter().chain(&["proto/dm_env_rpc/v1/dm_env_rpc.proto"]), ["proto"])?;
    // What the server tells those who ask it by reflection.
    std::fs::write(Path::new(&std::env::var("OUT_DIR")?).join("descriptors.bin"), files.encode_to_vec())?;
    tonic_prost_build::configure().bytes(".sandgait.v1").compile_fds(files)?;
    Ok(())
}

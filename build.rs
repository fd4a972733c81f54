//! Compiles the protos in pure Rust: no protoc is needed.

use prost::Message as _;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=proto");
    let ours = ["proto/sandgait/v1/sandgait.proto", "proto/sandgait/v1/studies.proto"];
    let files = protox::compile(ours.iter().chain(&["proto/dm_env_rpc/v1/dm_env_rpc.proto"]), ["proto"])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    // What the server tells those who ask it by reflection.
    std::fs::write(out.join("descriptors.bin"), files.encode_to_vec())?;
    server(files.clone(), &out.join("server"))?;
    // Messages and clients.
    tonic_prost_build::configure().build_server(false).bytes(".sandgait.v1").compile_fds(files)?;
    Ok(())
}

/// The servers' traits. A request reaches them as a `Frame`: its bytes, which are sized before they are unpacked.
fn server(files: prost_types::FileDescriptorSet, out: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let packages = [("sandgait.v1", "crate::service::proto"), ("dm_env_rpc.v1", "crate::service::dm_env_rpc::proto")];
    let messages = packages.iter().map(|(package, module)| (format!(".{package}"), (*module).to_owned()));
    let requests = files.file.iter().filter_map(|file| {
        let (_, module) = packages.iter().find(|(package, _)| file.package() == *package)?;
        let inputs = file.service.iter().flat_map(|s| &s.method).map(|m| m.input_type().to_owned());
        let frame = |input: String| {
            let name = input.rsplit('.').next().unwrap_or_default();
            let frame = format!("crate::service::frame::Frame<{module}::{name}>");
            (input, frame)
        };
        Some(inputs.map(frame).collect::<Vec<_>>())
    });
    let mut paths: Vec<(String, String)> = messages.chain(requests.flatten()).collect();
    paths.push((".google.rpc".into(), "crate::service::dm_env_rpc::proto::google::rpc".into()));
    std::fs::create_dir_all(out)?;
    let builder = tonic_prost_build::configure().build_client(false).codec_path("crate::service::frame::FrameCodec");
    let builder = paths.into_iter().fold(builder, |b, (proto, rust)| b.extern_path(proto, rust));
    Ok(builder.out_dir(out).compile_fds(files)?)
}

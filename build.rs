//! Compiles the protos in pure Rust: no protoc is needed.
fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=proto");
    let ours = ["proto/sandgait/v1/sandgait.proto", "proto/sandgait/v1/studies.proto"];
    let files = protox::compile(ours.iter().chain(&["proto/dm_env_rpc/v1/dm_env_rpc.proto"]), ["proto"])?;
    tonic_prost_build::configure().bytes(".sandgait.v1").compile_fds(files)?;
    Ok(())
}

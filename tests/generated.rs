//! Committed files that programs make: the code in `generated` folders is what the generators make from `proto/` now. It is committed so that a
//! build needs neither the generators nor protoc. `make proto` writes it again.

use prost::Message as _;
use sandgait::study::{page, python};
use std::path::{Path, PathBuf};

/// Generates all files into the folder `out`, without protoc.
fn make(out: &Path) {
    let ours = ["proto/sandgait/v1/sandgait.proto", "proto/sandgait/v1/studies.proto"];
    let files = protox::compile(ours.iter().chain(&["proto/dm_env_rpc/v1/dm_env_rpc.proto"]), ["proto"]).unwrap();
    std::fs::create_dir_all(out).unwrap();
    // The descriptors that the server's reflection service sends.
    std::fs::write(out.join("descriptors.bin"), files.encode_to_vec()).unwrap();
    server(files.clone(), &out.join("server"));
    // Messages and clients.
    let builder = tonic_prost_build::configure().build_server(false).bytes(".sandgait.v1").out_dir(out);
    builder.compile_fds(files).unwrap();
}

/// The traits of the services. Requests have the type `RequestFrame`: undecoded bytes, so that their size can be checked
/// before decoding.
fn server(files: prost_types::FileDescriptorSet, out: &Path) {
    let packages = [("sandgait.v1", "crate::proto"), ("dm_env_rpc.v1", "crate::proto")];
    let messages = packages.iter().map(|(package, module)| (format!(".{package}"), (*module).to_owned()));
    let requests = files.file.iter().filter_map(|file| {
        let (_, module) = packages.iter().find(|(package, _)| file.package() == *package)?;
        let inputs = file.service.iter().flat_map(|s| &s.method).map(|m| m.input_type().to_owned());
        let frame = |input: String| {
            let name = input.rsplit('.').next().unwrap_or_default();
            let frame = format!("crate::frame::RequestFrame<{module}::{name}>");
            (input, frame)
        };
        Some(inputs.map(frame).collect::<Vec<_>>())
    });
    let mut paths: Vec<(String, String)> = messages.chain(requests.flatten()).collect();
    paths.push((".google.rpc".into(), "crate::proto::google::rpc".into()));
    std::fs::create_dir_all(out).unwrap();
    let builder = tonic_prost_build::configure().build_client(false).codec_path("crate::frame::FrameCodec");
    let builder = paths.into_iter().fold(builder, |b, (proto, rust)| b.extern_path(proto, rust));
    builder.out_dir(out).compile_fds(files).unwrap();
}

#[test]
fn the_generated_code_is_current() {
    let committed = |name: &Path| {
        let ours = name.ends_with("descriptors.bin") || name.ends_with("sandgait.v1.rs");
        let folder = if ours { "src/service/generated" } else { "src/dm_env_rpc/generated" };
        Path::new(folder).join(name)
    };
    let directory = tempfile::tempdir().unwrap();
    make(directory.path());
    let mut names: Vec<PathBuf> = Vec::new();
    for folder in ["", "server"] {
        let entries = std::fs::read_dir(directory.path().join(folder)).unwrap().map(|e| e.unwrap().path());
        names.extend(entries.filter(|p| p.is_file()).map(|p| p.strip_prefix(directory.path()).unwrap().to_owned()));
    }
    assert!(names.len() >= 6);
    for name in names {
        let made = std::fs::read(directory.path().join(&name)).unwrap();
        if std::env::var_os("SANDGAIT_WRITE_PROTO").is_some() {
            std::fs::write(committed(&name), &made).unwrap();
        }
        assert!(made == std::fs::read(committed(&name)).unwrap(), "{}: make proto writes it anew", name.display());
    }
}

/// The functions in Python and the page of the reference are made from the declarations of the studies. `make studies` writes
/// them again.
#[test]
fn functions_and_pages_of_studies_are_current() {
    for (name, made) in
        [("python_client/sandgait/study_functions.py", python::module()), ("docs/reference/studies.md", page::page())]
    {
        let committed = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap_or_default();
        assert!(made == committed, "{name}: make studies writes it anew");
    }
}

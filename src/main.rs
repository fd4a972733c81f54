use clap::Parser;
use sandgait::diagnose;

#[derive(clap::Parser)]
enum Command {
    /// Show what the simulation gets wrong about measured data, and why
    Diagnose(diagnose::cli::Arguments),
}

fn main() -> std::process::ExitCode {
    match Command::parse() {
        Command::Diagnose(arguments) => match diagnose::run(&arguments) {
            Ok(diagnosis) => {
                println!("{}", diagnosis.report.summary);
                std::process::ExitCode::SUCCESS
            }
            Err(error) => {
                eprintln!("{error}");
                std::process::ExitCode::from(2)
            }
        },
    }
}

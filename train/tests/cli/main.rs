//! The command line from outside: exit codes, messages, and what is left on the disk.

mod bad_input;
mod cost;
mod evaluation;
mod help;
mod infer;
mod pretrain;
mod settings;
mod synth;
mod training;
mod verify;
mod weights;

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// What a command did.
struct Ran {
    code: i32,
    out: String,
    err: String,
}

fn command(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dimode"));
    command.args(args).stdin(Stdio::null());
    command
}

fn dimode(args: &[&str]) -> Ran {
    finished(command(args).output().expect("the program starts"))
}

/// The same, with `folder` as working directory.
fn dimode_in(folder: &Path, args: &[&str]) -> Ran {
    finished(command(args).current_dir(folder).output().expect("the program starts"))
}

fn finished(output: Output) -> Ran {
    Ran {
        code: output.status.code().expect("not killed"),
        out: String::from_utf8(output.stdout).expect("text"),
        err: String::from_utf8(output.stderr).expect("text"),
    }
}

impl Ran {
    /// Code 0; gives standard output.
    #[track_caller]
    fn succeeded(self) -> String {
        assert_eq!(self.code, 0, "{}", self.err);
        self.out
    }

    /// This code, nothing on standard output, and an error of at most two lines that contains all of `parts`.
    #[track_caller]
    fn refused(&self, code: i32, parts: &[&str]) {
        self.refused_with_list(code, "", parts);
    }

    /// The same with lines before it that list what is wrong, one of which is `listed`.
    #[track_caller]
    fn refused_with_list(&self, code: i32, listed: &str, parts: &[&str]) {
        assert_eq!(self.code, code, "{}{}", self.out, self.err);
        assert_eq!(self.out, "");
        let (list, told) = self.err.split_at(self.err.find("error: ").unwrap_or(0));
        assert!(list.contains(listed) && list.is_empty() == listed.is_empty(), "{}", self.err);
        assert!(told.starts_with("error: ") && told.lines().count() <= 2, "{}", self.err);
        for part in parts {
            assert!(told.contains(part), "'{part}' is not in: {}", self.err);
        }
    }
}

/// A folder of `count` frames with an intrinsics file that fits.
fn frames(folder: &Path, count: usize) {
    fs::create_dir_all(folder).unwrap();
    for i in 0..count {
        let colour = |c, v, u| ((c + v * 3 + u * 5 + i) % 17) as f32 / 17.0;
        let image = dimode::data::Image::from_fn(3, 64, 64, colour);
        dimode::data::write_rgb_png(&folder.join(format!("{i:06}.png")), &image).unwrap();
    }
    fs::write(folder.join("intrinsics.txt"), "48 48 31.5 31.5\n").unwrap();
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

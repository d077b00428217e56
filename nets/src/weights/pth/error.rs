//! Why a file of PyTorch was not read. The messages follow the name of the file.

use thiserror::Error;

/// Longest text from a file that a message repeats, in letters.
const LONGEST: usize = 60;

/// What is wrong with a file of PyTorch, or why it is not read.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PthError {
    /// It was written by `torch.save` of PyTorch 1.5 or older, or on request in that form.
    #[error(
        "is in the form of PyTorch 1.5 and older, which is not read; in Python: \
         torch.save(torch.load('OLD.pth', map_location='cpu', weights_only=True), 'NEW.pth')"
    )]
    Old,
    /// It is a pickle, but not one in a zip file.
    #[error("is a pickle that torch.save did not write; save the weights with torch.save(model.state_dict(), 'NEW.pth')")]
    BarePickle,
    /// It is a program.
    #[error(
        "is a TorchScript program, which is executable and not read; in Python: \
         torch.save(torch.jit.load('OLD.pt', map_location='cpu').state_dict(), 'NEW.pth')"
    )]
    TorchScript,
    /// It was written on a machine with the other order of bytes.
    #[error("was written with the most significant byte first; load and save it in Python on an ordinary machine")]
    ByteOrder,
    /// It names something outside the allow-list.
    #[error(
        "names '{name}': executable content is refused; a dictionary of tensors alone can be read, as \
         torch.save(model.state_dict(), 'NEW.pth') writes it"
    )]
    Refused {
        /// Module and name as Python has them.
        name: String,
    },
    /// Its pickle has an instruction that no dictionary of tensors needs.
    #[error("has instruction {code:#04x} at byte {at} of its pickle, which weights do not need; executable content is refused")]
    Instruction {
        /// The code.
        code: u8,
        /// Its place in the pickle.
        at: usize,
    },
    /// The end comes before something is complete.
    #[error("is cut or damaged: it ends within {what}")]
    Cut {
        /// What is not complete.
        what: &'static str,
    },
    /// Something is not as the format has it.
    #[error("is damaged: {what} at byte {at}")]
    Damaged {
        /// What is wrong.
        what: &'static str,
        /// Where.
        at: usize,
    },
    /// Something is not as the format has it in an entry of the archive.
    #[error("is damaged: entry '{entry}' {what}")]
    Entry {
        /// The name of the entry.
        entry: String,
        /// What is wrong.
        what: &'static str,
    },
    /// It is a zip file, but not one of `torch.save`.
    #[error("is a zip file, but not one that torch.save writes: it has no entry '{entry}'")]
    NoEntry {
        /// The name of the entry.
        entry: String,
    },
    /// Something is larger than any file of weights needs.
    #[error("has a {what} over the limit of {limit}")]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// The limit.
        limit: usize,
    },
    /// An entry has a name that no module can have.
    #[error("is damaged: it holds an entry '{name}', a name that is too long or not of printable letters")]
    Name {
        /// The name, cut and escaped.
        name: String,
    },
    /// There is no dictionary of tensors where one is looked for.
    #[error("holds no dictionary of tensors: {found}; save the weights with torch.save(model.state_dict(), 'NEW.pth')")]
    NoTensors {
        /// What there is instead.
        found: String,
    },
    /// A tensor does not lie within its storage.
    #[error("is damaged: tensor '{name}' of dimensions {dims:?} does not lie within its storage of {held} values")]
    OutOfStorage {
        /// Name of the tensor.
        name: String,
        /// Its dimensions.
        dims: Vec<usize>,
        /// Values of the storage.
        held: usize,
    },
}

/// Text from a file, as a message may repeat it: cut, and without letters that steer a terminal.
pub(super) fn shown(text: &str) -> String {
    let safe = |letter: char| if letter.is_control() { '?' } else { letter };
    let more = if text.chars().nth(LONGEST).is_some() { "..." } else { "" };
    text.chars().take(LONGEST).map(safe).chain(more.chars()).collect()
}

//! The machine that a pickle is a program for, as far as dictionaries of tensors need it.
//!
//! A stack, a memo of values to come back to, and values that refer to each other by number: no value owns another, so that neither
//! depth nor cycles of what a file describes reach our own stack. Nothing is imported and nothing is called; a name outside
//! [`super::names`] ends the run before anything is done with it.

use std::collections::BTreeMap;

use super::bytes::Bytes;
use super::error::{PthError, shown};
use super::names::{Global, allowed};
use super::value::{Id, Pickled, StorageRef, TensorRef, Value};

/// Most values that a pickle may make; a network of two thousand tensors with the states of its optimiser makes about 150,000.
const MOST_VALUES: usize = 1 << 20;
/// Most containers that may be open at once; those of checkpoints are ten deep.
const MOST_MARKS: usize = 1 << 10;
/// Most axes of a tensor.
const MOST_AXES: usize = 16;
/// Highest protocol of pickles.
const PROTOCOL: u8 = 5;

/// Runs a pickle to its end.
pub(super) fn run(pickle: &[u8]) -> Result<Pickled, PthError> {
    let machine = Machine {
        code: Bytes::new(pickle, 0),
        at: 0,
        values: Vec::new(),
        stack: Vec::new(),
        marks: Vec::new(),
        memo: BTreeMap::new(),
    };
    machine.run()
}

struct Machine<'a> {
    code: Bytes<'a>,
    /// Place of the instruction that runs.
    at: usize,
    values: Vec<Value>,
    stack: Vec<Id>,
    /// Heights of the stack that were marked.
    marks: Vec<usize>,
    memo: BTreeMap<u64, Id>,
}

impl<'a> Machine<'a> {
    fn run(mut self) -> Result<Pickled, PthError> {
        loop {
            self.at = self.code.at();
            let code = self.read(Bytes::u8)?;
            if code == b'.' {
                let top = self.pop()?;
                return Ok(Pickled::new(self.values, top));
            }
            self.step(code)?;
        }
    }

    fn step(&mut self, code: u8) -> Result<(), PthError> {
        match code {
            // Beginnings of protocols and of parts of the pickle.
            0x80 => match self.read(Bytes::u8)? {
                0..=PROTOCOL => Ok(()),
                _ => Err(self.damaged("a protocol of pickles that is not known")),
            },
            0x95 => self.read(Bytes::u64).map(|_| ()),
            b'N' => self.push(Value::None),
            0x88 | 0x89 => self.push(Value::Bool(code == 0x88)),
            b'J' | b'K' | b'M' | 0x8a | 0x8b | b'G' => self.number(code),
            b'X' | 0x8c | 0x8d => self.text(code),
            b'B' | b'C' | 0x8e => {
                let length = self.length(match code {
                    b'B' => 4,
                    b'C' => 1,
                    _ => 8,
                })?;
                self.read(|bytes| bytes.take(length))?;
                self.push(Value::Bytes)
            }
            b'(' | b']' | b'}' | b')' | b't' | b'l' | b'd' | 0x85..=0x87 | 0x8f | 0x91 => self.container(code),
            b'a' | b'e' | b's' | b'u' | 0x90 => self.fill(code),
            b'q' | b'r' | 0x94 | b'h' | b'j' => self.memo(code),
            b'c' | 0x93 | b'Q' | b'R' | 0x81 | b'b' => self.object(code),
            b'0' => self.pop().map(|_| ()),
            _ => Err(PthError::Instruction { code, at: self.at }),
        }
    }

    fn number(&mut self, code: u8) -> Result<(), PthError> {
        let value = match code {
            b'J' => Value::Int(i64::from(i32::from_le_bytes(self.read(Bytes::array)?))),
            b'K' => Value::Int(i64::from(self.read(Bytes::u8)?)),
            b'M' => Value::Int(i64::from(self.read(Bytes::u16)?)),
            // The one kind of number that stands with its most significant byte first.
            b'G' => Value::Float(f64::from_be_bytes(self.read(Bytes::array)?)),
            _ => {
                let length = self.length(if code == 0x8a { 1 } else { 4 })?;
                whole_number(self.read(|bytes| bytes.take(length))?)
            }
        };
        self.push(value)
    }

    fn text(&mut self, code: u8) -> Result<(), PthError> {
        let length = self.length(match code {
            b'X' => 4,
            0x8c => 1,
            _ => 8,
        })?;
        let bytes = self.read(|bytes| bytes.take(length))?;
        let text = std::str::from_utf8(bytes).map_err(|_| self.damaged("text that is not UTF-8"))?.to_owned();
        self.push(Value::Text(text))
    }

    /// Makes lists, tuples, dictionaries and sets.
    fn container(&mut self, code: u8) -> Result<(), PthError> {
        let value = match code {
            b'(' => {
                limited(self.marks.len(), "number of open containers in its pickle", MOST_MARKS)?;
                self.marks.push(self.stack.len());
                return Ok(());
            }
            b']' => Value::List(Vec::new()),
            b'}' => Value::Dict(Vec::new()),
            b')' => Value::Tuple(Vec::new()),
            0x8f => Value::Set,
            b't' => Value::Tuple(self.pop_marked()?),
            b'l' => Value::List(self.pop_marked()?),
            b'd' => {
                let items = self.pop_marked()?;
                Value::Dict(self.pairs(items)?)
            }
            0x91 => {
                self.pop_marked()?;
                Value::Set
            }
            _ => {
                let mut items = (0x85..=code).map(|_| self.pop()).collect::<Result<Vec<_>, _>>()?;
                items.reverse();
                Value::Tuple(items)
            }
        };
        self.push(value)
    }

    /// Puts items into what is on the stack below them.
    fn fill(&mut self, code: u8) -> Result<(), PthError> {
        let items = match code {
            b'a' => vec![self.pop()?],
            b's' => {
                let value = self.pop()?;
                vec![self.pop()?, value]
            }
            _ => self.pop_marked()?,
        };
        let target = *self.stack.last().ok_or_else(|| self.damaged("items for nothing"))?;
        let pairs = if matches!(code, b's' | b'u') { self.pairs(items.clone())? } else { Vec::new() };
        match (code, &mut self.values[target]) {
            (b'a' | b'e', Value::List(list)) => list.extend(items),
            (b's' | b'u', Value::Dict(dict)) => dict.extend(pairs),
            (0x90, Value::Set) => {}
            _ => return Err(self.damaged("items for something that takes none")),
        }
        Ok(())
    }

    fn memo(&mut self, code: u8) -> Result<(), PthError> {
        let key = match code {
            b'q' | b'h' => u64::from(self.read(Bytes::u8)?),
            b'r' | b'j' => u64::from(self.read(Bytes::u32)?),
            _ => self.memo.len() as u64,
        };
        if matches!(code, b'h' | b'j') {
            let id = *self.memo.get(&key).ok_or_else(|| self.damaged("a value that was not kept"))?;
            limited(self.stack.len(), "number of values on the stack of its pickle", MOST_VALUES)?;
            self.stack.push(id);
            return Ok(());
        }
        limited(self.memo.len(), "number of values kept in its pickle", MOST_VALUES)?;
        let id = *self.stack.last().ok_or_else(|| self.damaged("nothing to keep"))?;
        self.memo.insert(key, id);
        Ok(())
    }

    /// Names, and what Python would make by calling them.
    fn object(&mut self, code: u8) -> Result<(), PthError> {
        match code {
            b'c' => {
                let [module, name] = [self.read(Bytes::line)?, self.read(Bytes::line)?];
                let [module, name] = [module, name].map(|text| String::from_utf8_lossy(text).into_owned());
                self.name(&module, &name)
            }
            0x93 => {
                let name = self.pop_text()?;
                let module = self.pop_text()?;
                self.name(&module, &name)
            }
            b'Q' => {
                let id = self.pop()?;
                let storage = self.storage(id).ok_or_else(|| self.damaged("a reference that names no storage"))?;
                self.push(Value::Storage(storage))
            }
            b'b' => self.build(),
            _ => self.call(code == 0x81),
        }
    }

    fn name(&mut self, module: &str, name: &str) -> Result<(), PthError> {
        match allowed(module, name) {
            Some(global) => self.push(Value::Global(global)),
            None => Err(PthError::Refused { name: shown(&format!("{module}.{name}")) }),
        }
    }

    /// A reference of torch to a storage: the word 'storage', type, key, device, number of values.
    fn storage(&self, id: Id) -> Option<StorageRef> {
        let Value::Tuple(parts) = &self.values[id] else { return None };
        let &[word, kind, key, _device, count] = parts.as_slice() else { return None };
        let word = matches!(&self.values[word], Value::Text(text) if text == "storage");
        match (word, &self.values[kind], &self.values[key]) {
            (true, Value::Global(Global::Storage(element)), Value::Text(key)) => {
                Some(StorageRef { element: *element, key: key.clone(), count: self.size(count)? })
            }
            _ => None,
        }
    }

    /// A name of the allow-list with its arguments; `new` when it is asked for a fresh object of a class.
    fn call(&mut self, new: bool) -> Result<(), PthError> {
        let (arguments, callee) = (self.pop()?, self.pop()?);
        let Value::Tuple(arguments) = self.values[arguments].clone() else {
            return Err(self.damaged("arguments that are no tuple"));
        };
        let Value::Global(global) = self.values[callee] else {
            return Err(PthError::Refused { name: "a call of something that is no name".to_owned() });
        };
        match (global, arguments.as_slice()) {
            (Global::OrderedDict, []) => self.push(Value::Dict(Vec::new())),
            (Global::Namespace, []) if new => self.push(Value::Settings),
            (Global::Size, &[sizes]) if !new && self.sizes(sizes).is_some() => {
                self.stack.push(sizes);
                Ok(())
            }
            (Global::RebuildParameter, &[tensor, _, _]) if !new && matches!(self.values[tensor], Value::Tensor(_)) => {
                self.stack.push(tensor);
                Ok(())
            }
            (Global::RebuildTensor, &[storage, offset, dims, strides, _, _] | &[storage, offset, dims, strides, _, _, _])
                if !new =>
            {
                let tensor = self.tensor(storage, [offset, dims, strides]);
                let tensor = tensor.ok_or_else(|| self.damaged("a tensor that is not described as one"))?;
                self.push(Value::Tensor(tensor))
            }
            _ => Err(self.damaged("arguments that do not fit")),
        }
    }

    fn tensor(&self, storage: Id, [offset, dims, strides]: [Id; 3]) -> Option<TensorRef> {
        let (dims, strides) = (self.sizes(dims)?, self.sizes(strides)?);
        let whole = matches!(self.values[storage], Value::Storage(_)) && dims.len() == strides.len();
        whole.then_some(TensorRef { storage, offset: self.size(offset)?, dims, strides })
    }

    /// Attributes of an object: those of settings are read over, and of dictionaries the versions of modules.
    fn build(&mut self) -> Result<(), PthError> {
        let attributes = self.pop()?;
        let target = *self.stack.last().ok_or_else(|| self.damaged("attributes of nothing"))?;
        let Value::Dict(attributes) = &self.values[attributes] else {
            return Err(self.damaged("attributes that are no dictionary"));
        };
        let metadata = |&(key, _): &(Id, Id)| matches!(&self.values[key], Value::Text(name) if name == "_metadata");
        match self.values[target] {
            Value::Settings => Ok(()),
            Value::Dict(_) if attributes.len() <= 1 && attributes.iter().all(metadata) => Ok(()),
            _ => Err(self.damaged("attributes that weights do not have")),
        }
    }

    fn size(&self, id: Id) -> Option<usize> {
        match self.values[id] {
            Value::Int(value) => usize::try_from(value).ok(),
            _ => None,
        }
    }

    fn sizes(&self, id: Id) -> Option<Vec<usize>> {
        match &self.values[id] {
            Value::Tuple(items) if items.len() <= MOST_AXES => items.iter().map(|&item| self.size(item)).collect(),
            _ => None,
        }
    }

    fn pairs(&self, items: Vec<Id>) -> Result<Vec<(Id, Id)>, PthError> {
        if !items.len().is_multiple_of(2) {
            return Err(self.damaged("a key without a value"));
        }
        Ok(items.chunks_exact(2).map(|pair| (pair[0], pair[1])).collect())
    }

    fn push(&mut self, value: Value) -> Result<(), PthError> {
        limited(self.values.len(), "number of values in its pickle", MOST_VALUES)?;
        self.stack.push(self.values.len());
        self.values.push(value);
        Ok(())
    }

    fn pop(&mut self) -> Result<Id, PthError> {
        let marked = self.marks.last().copied().unwrap_or(0);
        let popped = if self.stack.len() > marked { self.stack.pop() } else { None };
        popped.ok_or_else(|| self.damaged("nothing on the stack"))
    }

    fn pop_text(&mut self) -> Result<String, PthError> {
        let id = self.pop()?;
        match &self.values[id] {
            Value::Text(text) => Ok(text.clone()),
            _ => Err(self.damaged("a name that is no text")),
        }
    }

    /// Everything above the last mark.
    fn pop_marked(&mut self) -> Result<Vec<Id>, PthError> {
        let mark = self.marks.pop().ok_or_else(|| self.damaged("no mark on the stack"))?;
        Ok(self.stack.split_off(mark))
    }

    /// A length of `size` bytes.
    fn length(&mut self, size: usize) -> Result<usize, PthError> {
        let bytes = self.read(|bytes| bytes.take(size))?;
        let length = bytes.iter().rev().fold(0u64, |length, &byte| length << 8 | u64::from(byte));
        usize::try_from(length).map_err(|_| PthError::Cut { what: "its pickle" })
    }

    fn read<R>(&mut self, read: impl FnOnce(&mut Bytes<'a>) -> Option<R>) -> Result<R, PthError> {
        read(&mut self.code).ok_or(PthError::Cut { what: "its pickle" })
    }

    fn damaged(&self, what: &'static str) -> PthError {
        PthError::Damaged { what, at: self.at }
    }
}

/// Refuses one more than `limit`.
fn limited(count: usize, what: &'static str, limit: usize) -> Result<(), PthError> {
    if count < limit { Ok(()) } else { Err(PthError::TooLarge { what, limit }) }
}

/// A number in two's complement, least significant byte first; none is zero.
fn whole_number(bytes: &[u8]) -> Value {
    if bytes.len() > 8 {
        return Value::Large;
    }
    let negative = bytes.last().is_some_and(|&last| last >= 0x80);
    let mut all = [if negative { 0xff } else { 0 }; 8];
    all[..bytes.len()].copy_from_slice(bytes);
    Value::Int(i64::from_le_bytes(all))
}

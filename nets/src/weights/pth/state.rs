//! The dictionary of tensors in what a pickle describes.

use std::borrow::Cow;
use std::collections::BTreeMap;

use super::super::names::is_counter;
use super::super::{Form, Ignored, WeightFile};
use super::error::{PthError, shown};
use super::storage::Storages;
use super::value::{Id, Pickled, Value};

/// Keys under which training programs put the dictionary, in the order in which they are looked at.
const USUAL_KEYS: [&str; 4] = ["state_dict", "model_state_dict", "model", "net"];
/// Longest name of an entry in bytes.
const LONGEST_NAME: usize = 1024;
/// How many keys an error names.
const NAMED: usize = 6;

/// Reads all tensors of the dictionary that a pickle describes, or of the one under a usual key in it.
pub(super) fn read(pickled: &Pickled, storages: &mut Storages) -> Result<WeightFile, PthError> {
    let Value::Dict(top) = pickled.top() else {
        return Err(PthError::NoTensors { found: describe(pickled.top()) });
    };
    let under = USUAL_KEYS.iter().find_map(|&key| {
        let value = top.iter().rev().find(|(id, _)| matches!(pickled.get(*id), Value::Text(text) if text == key))?.1;
        match pickled.get(value) {
            Value::Dict(dict) if holds_tensors(pickled, dict) => Some((key, dict)),
            _ => None,
        }
    });
    let (under, dict) = match under {
        Some((key, dict)) => (Some(key.to_owned()), dict),
        None if holds_tensors(pickled, top) => (None, top),
        None => return Err(PthError::NoTensors { found: keys(pickled, top)? }),
    };
    let mut file = WeightFile { form: Form::PyTorch, under, tensors: Vec::new(), counters: 0, ignored: Vec::new() };
    if let Some(key) = &file.under {
        let others = last_of_each(pickled, top)?.into_iter().filter(|(name, _)| name != key);
        file.ignored.extend(others.map(|(name, value)| Ignored { name, what: describe(pickled.get(value)) }));
    }
    for (name, value) in last_of_each(pickled, dict)? {
        match pickled.get(value) {
            Value::Tensor(_) if is_counter(&name) => file.counters += 1,
            Value::Tensor(tensor) => {
                let Value::Storage(storage) = pickled.get(tensor.storage) else {
                    return Err(PthError::NoTensors { found: format!("'{name}' has no storage") });
                };
                file.tensors.push(storages.read(&name, tensor, storage)?);
            }
            other => file.ignored.push(Ignored { name, what: describe(other) }),
        }
    }
    Ok(file)
}

fn holds_tensors(pickled: &Pickled, dict: &[(Id, Id)]) -> bool {
    dict.iter().any(|&(_, value)| matches!(pickled.get(value), Value::Tensor(_)))
}

/// Names and values in the order of the first appearance of each name, with the value that was put last.
fn last_of_each(pickled: &Pickled, dict: &[(Id, Id)]) -> Result<Vec<(String, Id)>, PthError> {
    let mut places: BTreeMap<Cow<str>, usize> = BTreeMap::new();
    let mut entries: Vec<(String, Id)> = Vec::new();
    for &(key, value) in dict {
        let name = name(pickled.get(key))?;
        match places.get(&name) {
            Some(&place) => entries[place].1 = value,
            None => {
                entries.push((name.clone().into_owned(), value));
                places.insert(name, entries.len() - 1);
            }
        }
    }
    Ok(entries)
}

/// The name under a key; a key that is no text is told in words.
fn name(key: &Value) -> Result<Cow<'_, str>, PthError> {
    match key {
        Value::Text(text) if text.len() <= LONGEST_NAME && !text.chars().any(char::is_control) => Ok(text.into()),
        Value::Text(text) => Err(PthError::Name { name: shown(text) }),
        other => Ok(describe(other).into()),
    }
}

fn keys(pickled: &Pickled, dict: &[(Id, Id)]) -> Result<String, PthError> {
    let names: Vec<String> = last_of_each(pickled, dict)?.into_iter().map(|(name, _)| shown(&name)).collect();
    let (first, rest) = names.split_at(names.len().min(NAMED));
    let more = if rest.is_empty() { "" } else { ", ..." };
    Ok(if names.is_empty() { "it is empty".to_owned() } else { format!("its keys are {}{more}", first.join(", ")) })
}

/// A value in a few words.
fn describe(value: &Value) -> String {
    match value {
        Value::None => "None".to_owned(),
        Value::Bool(value) => value.to_string(),
        Value::Int(value) => value.to_string(),
        Value::Float(value) => value.to_string(),
        Value::Text(text) => format!("'{}'", shown(text)),
        Value::Large => "a large number".to_owned(),
        Value::Bytes => "bytes".to_owned(),
        Value::List(items) => format!("a list of {}", items.len()),
        Value::Tuple(items) => format!("a tuple of {}", items.len()),
        Value::Set => "a set".to_owned(),
        Value::Dict(pairs) => format!("a dictionary of {}", pairs.len()),
        Value::Settings => "settings of a program".to_owned(),
        Value::Global(_) => "a name".to_owned(),
        Value::Storage(_) => "a storage".to_owned(),
        Value::Tensor(tensor) => format!("a tensor of dimensions {:?}", tensor.dims),
    }
}

//! From tensors of a file to the parameters of a network.

use std::collections::{BTreeMap, BTreeSet};

use dimode_autodiff::{Scalar, Tensor};

use super::names::{by_plain_name, plain_name, resolve_aliases};
use super::{Differences, Misshapen, StoredTensor, WeightError};
use crate::Params;
use crate::params::shape_of;

/// Replaces every value of `params` by those of `tensors`; nothing changes on an error. What wrappers put before names is taken
/// off (`module.`, `_orig_mod.`), and the second name of a tensor that the reference registers twice stands for its first.
///
/// # Errors
/// [`WeightError::Mismatch`] with all differences, unless names and dimensions are equal; [`WeightError::Twice`] for a name that
/// comes twice; [`WeightError::NoWeights`] for whole numbers; [`WeightError::NonFinite`] for the first value that is not finite in
/// the precision of `T`.
pub fn assign<T: Scalar>(params: &mut Params<T>, tensors: Vec<StoredTensor>, origin: &str) -> Result<(), WeightError> {
    let (fitting, differences) = matched(params, tensors, origin)?;
    if !differences.is_empty() {
        return Err(WeightError::Mismatch { origin: origin.to_owned(), differences });
    }
    check_values::<T>(&fitting, origin)?;
    put(params, fitting);
    Ok(())
}

/// Replaces the values of those tensors of `params` that `tensors` has in the same dimensions, and returns all differences:
/// what is missing or of another size keeps its value, and what is not known is left out. Nothing changes on an error.
///
/// # Errors
/// As [`assign`], but [`WeightError::Mismatch`] only when not a single tensor fits.
pub fn assign_partial<T: Scalar>(
    params: &mut Params<T>,
    tensors: Vec<StoredTensor>,
    origin: &str,
) -> Result<Differences, WeightError> {
    let (fitting, differences) = matched(params, tensors, origin)?;
    if fitting.is_empty() {
        return Err(WeightError::Mismatch { origin: origin.to_owned(), differences });
    }
    check_values::<T>(&fitting, origin)?;
    put(params, fitting);
    Ok(differences)
}

/// What keeps tensors from being those that a file of a network holds, both as names with dimensions.
pub fn differences<'a>(
    expected: impl IntoIterator<Item = (&'a str, &'a [usize])>,
    tensors: impl IntoIterator<Item = (&'a str, &'a [usize])>,
) -> Differences {
    let expected: Vec<(&str, &[usize])> = expected.into_iter().collect();
    let names: BTreeSet<&str> = expected.iter().map(|(name, _)| *name).collect();
    let mut given = tensors.into_iter().map(|(name, dims)| (plain_name(name).to_owned(), dims)).collect();
    resolve_aliases(|name| names.contains(name), &mut given);
    compare(expected.into_iter(), &given)
}

/// The tensors that fit, by name, and all that does not.
fn matched<T: Scalar>(
    params: &Params<T>,
    tensors: Vec<StoredTensor>,
    origin: &str,
) -> Result<(BTreeMap<String, StoredTensor>, Differences), WeightError> {
    let mut given = by_plain_name(tensors, origin)?;
    resolve_aliases(|name| params.get(name).is_some(), &mut given);
    let dims: BTreeMap<String, &[usize]> = given.iter().map(|(name, tensor)| (name.clone(), tensor.dims.as_slice())).collect();
    let differences = compare(params.iter().map(|(name, entry)| (name, entry.dims())), &dims);
    given.retain(|name, tensor| params.get(name).is_some_and(|entry| entry.dims() == tensor.dims));
    Ok((given, differences))
}

fn compare<'a>(expected: impl Iterator<Item = (&'a str, &'a [usize])>, given: &BTreeMap<String, &[usize]>) -> Differences {
    let mut differences = Differences::default();
    let mut extra: BTreeSet<&str> = given.keys().map(String::as_str).collect();
    for (name, dims) in expected {
        extra.remove(name);
        match given.get(name) {
            None => differences.missing.push(name.to_owned()),
            Some(&found) if found != dims => {
                let (expected, found) = (dims.to_vec(), found.to_vec());
                differences.misshapen.push(Misshapen { name: name.to_owned(), expected, found });
            }
            Some(_) => {}
        }
    }
    differences.extra = extra.into_iter().map(str::to_owned).collect();
    differences
}

fn check_values<T: Scalar>(tensors: &BTreeMap<String, StoredTensor>, origin: &str) -> Result<(), WeightError> {
    for (name, tensor) in tensors {
        let (origin, name) = (|| origin.to_owned(), || name.clone());
        if !tensor.element.is_float() {
            return Err(WeightError::NoWeights { origin: origin(), name: name(), element: tensor.element });
        }
        if let Some(index) = tensor.values.iter().position(|&value| !T::from_f64(value).to_f64().is_finite()) {
            return Err(WeightError::NonFinite { origin: origin(), name: name(), index, value: tensor.values[index] });
        }
    }
    Ok(())
}

fn put<T: Scalar>(params: &mut Params<T>, mut fitting: BTreeMap<String, StoredTensor>) {
    for (name, entry) in params.iter_mut() {
        if let Some(stored) = fitting.remove(name) {
            let values = stored.values.into_iter().map(T::from_f64).collect();
            entry.set(Tensor::from_vec(shape_of(&stored.dims), values));
        }
    }
}

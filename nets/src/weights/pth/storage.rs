//! From a view into a storage to its values.

use std::collections::BTreeMap;

use super::super::{ElementType, StoredTensor};
use super::error::PthError;
use super::value::{StorageRef, TensorRef};
use super::zip::Archive;

/// The storages of an archive. Each is checked once; all tensors together may hold as many values as the file has bytes, which
/// leaves room for two names of one tensor and none for a small file that fills the memory.
pub(super) struct Storages<'a> {
    archive: &'a Archive<'a>,
    root: &'a str,
    checked: BTreeMap<String, &'a [u8]>,
    left: usize,
}

impl<'a> Storages<'a> {
    /// The storages under the folder `root`.
    pub(super) fn new(archive: &'a Archive<'a>, root: &'a str) -> Self {
        Self { archive, root, checked: BTreeMap::new(), left: archive.length() }
    }

    /// The values of a tensor, row-major.
    pub(super) fn read(&mut self, name: &str, tensor: &TensorRef, storage: &StorageRef) -> Result<StoredTensor, PthError> {
        let bytes = self.bytes(storage)?;
        let outside = || PthError::OutOfStorage { name: name.to_owned(), dims: tensor.dims.clone(), held: storage.count };
        let count = count_within(tensor, storage.count).ok_or_else(outside)?;
        self.left = self
            .left
            .checked_sub(count)
            .ok_or(PthError::TooLarge { what: "number of values in all tensors together", limit: self.archive.length() })?;
        let values = gather(storage.element, bytes, tensor, count);
        Ok(StoredTensor { name: name.to_owned(), element: storage.element, dims: tensor.dims.clone(), values })
    }

    /// The bytes of a storage, which must be as many as the pickle says.
    fn bytes(&mut self, storage: &StorageRef) -> Result<&'a [u8], PthError> {
        let entry = format!("{}/data/{}", self.root, storage.key);
        let bytes = match self.checked.get(&entry) {
            Some(bytes) => bytes,
            None => {
                let bytes = self.archive.data(&entry)?;
                self.checked.insert(entry.clone(), bytes);
                bytes
            }
        };
        if storage.count.checked_mul(storage.element.size()) != Some(bytes.len()) {
            return Err(PthError::Entry { entry, what: "has another length than the pickle says" });
        }
        Ok(bytes)
    }
}

/// Number of values of a tensor, if all of them lie among `held`.
fn count_within(tensor: &TensorRef, held: usize) -> Option<usize> {
    let count = tensor.dims.iter().try_fold(1usize, |count, &side| count.checked_mul(side))?;
    if count == 0 {
        return Some(0);
    }
    let steps = tensor.dims.iter().zip(&tensor.strides);
    let last = steps
        .map(|(&side, &stride)| (side - 1).checked_mul(stride))
        .try_fold(tensor.offset, |last, step| last.checked_add(step?));
    // A view may repeat values, but not be larger than what it views.
    (last? < held && count <= held).then_some(count)
}

/// The values at the places of a tensor that lies within its storage.
fn gather(element: ElementType, bytes: &[u8], tensor: &TensorRef, count: usize) -> Vec<f64> {
    // The other sides of an empty tensor may be of any length.
    if count == 0 {
        return Vec::new();
    }
    let size = element.size();
    let run = contiguous_run(tensor);
    let mut values = Vec::with_capacity(count);
    let mut place = vec![0usize; tensor.dims.len()];
    while values.len() < count {
        let at = tensor.offset + place.iter().zip(&tensor.strides).map(|(index, stride)| index * stride).sum::<usize>();
        element.decode(&bytes[at * size..(at + run) * size], &mut values);
        advance(&mut place, &tensor.dims, run);
    }
    values
}

/// How many values from each place on follow each other in the storage.
fn contiguous_run(tensor: &TensorRef) -> usize {
    let mut run = 1;
    for (&side, &stride) in tensor.dims.iter().zip(&tensor.strides).rev() {
        if side != 1 && stride != run {
            break;
        }
        run *= side;
    }
    run
}

/// Moves a place on by `run` values in row-major order.
fn advance(place: &mut [usize], dims: &[usize], run: usize) {
    let mut carry = run;
    for (index, &side) in place.iter_mut().zip(dims).rev() {
        let moved = *index + carry;
        (*index, carry) = (moved % side, moved / side);
    }
}

//! The tape: records operations, then walks them backwards.

mod var;

use std::sync::{Arc, Mutex, MutexGuard};

use crate::grad_sink::{GradSink, GradSlot};
use crate::gradients::{Gradients, Place};
use crate::proof::Planted;
use crate::segments::Segments;
use crate::{Pool, Scalar, Shape, Tensor};
pub use var::Var;

/// What an operation does in the backward pass: given the gradient of its output, add to the gradients of its parents.
type Backward<T> = Box<dyn Fn(&Tensor<T>, &mut GradSink<'_, T>) + Send>;

struct Node<T: Scalar> {
    op: &'static str,
    shape: Shape,
    value: Option<Tensor<T>>,
    parents: Box<[usize]>,
    backward: Option<Backward<T>>,
    requires_grad: bool,
    keeps_grad: bool,
}

/// Why a lock of the tape is always there.
const UNBROKEN: &str = "a tape is not used again after a panic";

/// A record of operations on variables.
///
/// Nodes are appended in the order of computation, so the backward pass is a loop from the end: no recursion, any depth.
/// A tape lives for one step; buffers outlive it in its [`Pool`]. Two threads may each record and differentiate on a tape of their
/// own; on one tape together they would record in an order that depends on chance.
pub struct Tape<T: Scalar> {
    nodes: Mutex<Segments<Node<T>>>,
    pool: Arc<Pool<T>>,
    /// Whether a value or gradient that is not finite is refused.
    finite_only: bool,
    /// A fault in one backward rule, for the test of the gradient checks.
    planted: Mutex<Option<Planted<T>>>,
}

impl<T: Scalar> Default for Tape<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Scalar> Tape<T> {
    /// An empty tape with a pool of its own.
    pub fn new() -> Self {
        Self::with_pool(Pool::new())
    }

    /// An empty tape that takes its buffers from `pool`.
    pub fn with_pool(pool: Arc<Pool<T>>) -> Self {
        Tape { nodes: Mutex::new(Segments::new()), pool, finite_only: false, planted: Mutex::new(None) }
    }

    /// The same tape, but it panics as soon as an input, an operation's output or a gradient is NaN or infinite, and names the
    /// operation and the entry.
    ///
    /// For tests and for the search of a fault: every value is read once more. Other tapes let such numbers pass on; no
    /// operation hides them.
    ///
    /// ```should_panic
    /// use dimode_autodiff::{Tape, Tensor};
    ///
    /// let tape = Tape::<f64>::new().refusing_non_finite();
    /// let x = tape.leaf(Tensor::scalar(-1.0));
    /// x.sqrt(); // sqrt [1, 1, 1, 1]: entry [0, 0, 0, 0] of the output is NaN
    /// ```
    #[must_use]
    pub fn refusing_non_finite(self) -> Self {
        Tape { finite_only: true, ..self }
    }

    /// Whether a value or gradient that is not finite is refused.
    pub(crate) fn refuses_non_finite(&self) -> bool {
        self.finite_only
    }

    /// What is recorded. To be held for short: whoever holds it asks no variable of this tape anything.
    fn nodes(&self) -> MutexGuard<'_, Segments<Node<T>>> {
        self.nodes.lock().expect(UNBROKEN)
    }

    /// The pool of this tape's buffers.
    pub fn pool(&self) -> &Arc<Pool<T>> {
        &self.pool
    }

    /// Number of recorded nodes.
    pub fn len(&self) -> usize {
        self.nodes().len()
    }

    /// Whether nothing is recorded yet.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A variable whose gradient is wanted.
    #[track_caller]
    pub fn leaf(&self, value: Tensor<T>) -> Var<'_, T> {
        self.append("leaf", value, Box::new([]), None, true)
    }

    /// A value without gradient.
    #[track_caller]
    pub fn constant(&self, value: Tensor<T>) -> Var<'_, T> {
        self.append("constant", value, Box::new([]), None, false)
    }

    /// A pooled buffer of `len` zeros, to become an operation's output by [`Tape::tensor`].
    pub fn buffer(&self, len: usize) -> Vec<T> {
        self.pool.take_zeroed(len)
    }

    /// A pooled buffer of `len` elements with arbitrary contents, for outputs that are written everywhere.
    pub fn scratch(&self, len: usize) -> Vec<T> {
        self.pool.take(len)
    }

    /// A tensor over a pooled buffer; the buffer returns to the pool when the last handle is dropped.
    ///
    /// # Panics
    /// When the length is not that of the shape.
    #[track_caller]
    pub fn tensor(&self, shape: Shape, data: Vec<T>) -> Tensor<T> {
        Tensor::pooled(shape, data, &self.pool)
    }

    /// Records an operation: its output, its parents, and how the output's gradient adds to the parents' gradients.
    ///
    /// This is the way to define an operation, inside this crate or outside. `backward` receives the gradient of the output
    /// (same shape as the output) and one slot for each parent; it must add to the slots, never overwrite them, and may be
    /// called more than once. It is dropped at once when no parent requires a gradient.
    ///
    /// # Panics
    /// When a parent belongs to another tape.
    #[track_caller]
    pub fn push<'t>(
        &'t self,
        op: &'static str,
        output: Tensor<T>,
        parents: &[Var<'t, T>],
        backward: impl Fn(&Tensor<T>, &mut GradSink<'_, T>) + Send + 'static,
    ) -> Var<'t, T> {
        let (ids, requires_grad) = self.links(op, parents);
        let backward: Option<Backward<T>> = if requires_grad { Some(Box::new(backward)) } else { None };
        self.append(op, output, ids, backward, requires_grad)
    }

    /// Places of the parents, and whether one of them requires a gradient.
    #[track_caller]
    fn links(&self, op: &str, parents: &[Var<'_, T>]) -> (Box<[usize]>, bool) {
        assert!(parents.iter().all(|p| std::ptr::eq(p.tape, self)), "{op}: an operand belongs to another tape");
        (parents.iter().map(|p| p.id).collect(), parents.iter().any(|p| p.requires_grad()))
    }

    #[track_caller]
    fn append(
        &self,
        op: &'static str,
        value: Tensor<T>,
        parents: Box<[usize]>,
        backward: Option<Backward<T>>,
        requires_grad: bool,
    ) -> Var<'_, T> {
        if self.finite_only {
            assert_finite(&value, op, if parents.is_empty() { "value" } else { "output" });
        }
        let mut nodes = self.nodes();
        let keeps_grad = requires_grad && parents.is_empty();
        nodes.push(Node { op, shape: value.shape(), value: Some(value), parents, backward, requires_grad, keeps_grad });
        Var { tape: self, id: nodes.len() - 1 }
    }

    /// Gradients of a scalar with respect to every leaf (and every [`Var::retain_grad`]); the graph is kept.
    ///
    /// # Panics
    /// When `loss` is not a single number or belongs to another tape.
    #[track_caller]
    pub fn backward(&self, loss: Var<'_, T>) -> Gradients<T> {
        self.differentiate(loss, false)
    }

    /// As [`Tape::backward`], but frees values and saved state as soon as they have served.
    ///
    /// Values of variables recorded before `loss` are gone afterwards, except leaves and constants.
    ///
    /// # Panics
    /// When `loss` is not a single number or belongs to another tape.
    #[track_caller]
    pub fn backward_and_free(&self, loss: Var<'_, T>) -> Gradients<T> {
        self.differentiate(loss, true)
    }

    /// A vector-Jacobian product: gradients of `<seed, output>` with respect to every leaf; the graph is kept.
    ///
    /// # Panics
    /// When the shapes of `output` and `seed` differ or `output` belongs to another tape.
    #[track_caller]
    pub fn backward_with(&self, output: Var<'_, T>, seed: &Tensor<T>) -> Gradients<T> {
        assert!(std::ptr::eq(output.tape, self), "backward: the output belongs to another tape");
        let shape = output.shape();
        assert!(seed.shape() == shape, "backward: output {shape} needs a seed of its shape, got {}", seed.shape());
        let mut places = self.places();
        places[output.id].grad = Some(seed.clone());
        self.sweep(output.id, places, false)
    }

    /// Spoils one backward rule in the sweeps to come.
    pub(crate) fn plant(&self, planted: Planted<T>) {
        *self.planted.lock().expect(UNBROKEN) = Some(planted);
    }

    /// The backward rules recorded so far: node, its operation, and a parent that wants a gradient.
    pub(crate) fn rules(&self) -> Vec<(usize, &'static str, usize)> {
        let nodes = self.nodes();
        let wanted =
            |node: &Node<T>| (0..node.parents.len()).filter(|&k| nodes[node.parents[k]].requires_grad).collect::<Vec<_>>();
        let rules = |(id, node): (usize, &Node<T>)| wanted(node).into_iter().map(|k| (id, node.op, k)).collect::<Vec<_>>();
        nodes.iter().enumerate().flat_map(rules).collect()
    }

    /// Gradients of `<seed, output>` added to those that some leaves already have; values are freed on the way.
    pub(crate) fn pull_back(&self, output: Var<'_, T>, seed: &Tensor<T>, so_far: Vec<(Var<'_, T>, Tensor<T>)>) -> Gradients<T> {
        let mut places = self.places();
        for (leaf, gradient) in so_far {
            places[leaf.id].grad = Some(gradient);
        }
        GradSlot { shape: output.shape(), grad: &mut places[output.id].grad, pool: &self.pool }.add_tensor(seed);
        self.sweep(output.id, places, true)
    }

    /// Gradients of a scalar.
    #[track_caller]
    fn differentiate(&self, loss: Var<'_, T>, free: bool) -> Gradients<T> {
        assert!(std::ptr::eq(loss.tape, self), "backward: the loss belongs to another tape");
        let shape = loss.shape();
        assert!(shape.len() == 1, "backward: the loss must be one number, got shape {shape}");
        let mut places = self.places();
        places[loss.id].grad = Some(Tensor::full(shape, T::ONE));
        self.sweep(loss.id, places, free)
    }

    /// Places for the gradients of all nodes.
    fn places(&self) -> Segments<Place<T>> {
        let place = |n: &Node<T>| Place { shape: n.shape, needed: n.requires_grad, kept: n.keeps_grad, grad: None };
        self.nodes().iter().map(place).collect()
    }

    /// Walks from node `last` to the first and lets each hand its gradient on to its parents.
    fn sweep(&self, last: usize, mut places: Segments<Place<T>>, free: bool) -> Gradients<T> {
        let mut nodes = self.nodes();
        let planted = self.planted.lock().expect(UNBROKEN);
        for id in (0..=last).rev() {
            let node = &mut nodes[id];
            let grad = if node.keeps_grad { places[id].grad.clone() } else { places[id].grad.take() };
            let freed = grad.is_some() && node.requires_grad && !node.parents.is_empty() && node.backward.is_none();
            assert!(!freed, "backward: {} {} was freed by an earlier backward_and_free", node.op, node.shape);
            if let (Some(backward), Some(grad)) = (&node.backward, grad) {
                let planted = planted.as_ref().filter(|planted| planted.node == id);
                let others = planted.and_then(|planted| places[node.parents[planted.parent]].grad.take());
                let mut sink = GradSink { parents: &node.parents, places: &mut places, pool: &self.pool };
                backward(&grad, &mut sink);
                if let Some(planted) = planted {
                    let parent = node.parents[planted.parent];
                    let place = &mut places[parent];
                    let mut slot = GradSlot { shape: place.shape, grad: &mut place.grad, pool: &self.pool };
                    (planted.spoil)(slot.shape, slot.as_mut_slice());
                    others.iter().for_each(|others| slot.add_tensor(others));
                }
                if self.finite_only {
                    for gradient in node.parents.iter().filter_map(|&parent| places[parent].grad.as_ref()) {
                        assert_finite(gradient, node.op, "gradient that it passes on");
                    }
                }
            }
            if free && !node.parents.is_empty() {
                node.backward = None;
                node.value = None;
            }
        }
        Gradients { places }
    }
}

/// Refuses a tensor with an entry that is NaN or infinite.
#[track_caller]
fn assert_finite<T: Scalar>(tensor: &Tensor<T>, op: &str, what: &str) {
    if let Some(at) = tensor.data().iter().position(|x| !x.is_finite()) {
        let (index, value) = (tensor.shape().unravel(at), tensor.data()[at].to_f64());
        panic!("{op} {}: entry {index:?} of the {what} is {value}", tensor.shape());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn double<'t>(x: Var<'t, f64>) -> Var<'t, f64> {
        let y = x.value().data().iter().map(|v| 2.0 * v).collect();
        x.tape().push("double", Tensor::from_vec(x.shape(), y), &[x], |g, grads| {
            if let Some(mut slot) = grads.slot(0) {
                slot.accumulate(|i| 2.0 * g.data()[i]);
            }
        })
    }

    #[test]
    fn a_graph_of_a_hundred_thousand_nodes_needs_no_recursion() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::scalar(1e-3));
        let mut y = x;
        for i in 0..100_000 {
            y = if i % 2 == 0 { double(y) } else { y.scale(0.5) };
        }
        assert_eq!(y.value().item(), 1e-3);
        assert_eq!(tape.backward_and_free(y).wrt(x).item(), 1.0);
    }

    #[test]
    fn backward_twice_gives_the_same() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::scalar(3.0));
        let y = double(double(x));
        assert_eq!(tape.backward(y).wrt(x).item(), 4.0);
        assert_eq!(tape.backward(y).wrt(x).item(), 4.0);
    }

    #[test]
    fn a_seed_weighs_the_entries_of_the_output() {
        let tape = Tape::new();
        let row = |values: [f64; 3]| Tensor::from_vec(Shape::new(1, 1, 1, 3), values.to_vec());
        let x = tape.leaf(row([1.0, 2.0, 3.0]));
        assert_eq!(tape.backward_with(double(x.square()), &row([1.0, 0.0, -1.0])).wrt(x).data(), [4.0, 0.0, -12.0]);
    }

    #[test]
    #[should_panic(expected = "backward: output [1, 1, 1, 1] needs a seed of its shape, got [1, 1, 1, 2]")]
    fn a_seed_of_another_shape_is_refused() {
        let tape = Tape::new();
        tape.backward_with(double(tape.leaf(Tensor::scalar(3.0))), &Tensor::zeros(Shape::new(1, 1, 1, 2)));
    }

    #[test]
    fn a_detached_branch_passes_no_gradient_and_a_used_twice_variable_sums() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::scalar(3.0));
        let y = x.mul(x.detach()).add(double(x));
        assert_eq!(tape.backward(y).wrt(x).item(), 3.0 + 2.0);
    }

    #[test]
    fn a_retained_gradient_can_be_read() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::scalar(3.0));
        let middle = double(x).retain_grad();
        let grads = tape.backward(double(middle));
        assert_eq!(grads.wrt(middle).item(), 2.0);
        let unused = tape.leaf(Tensor::zeros(Shape::new(1, 1, 2, 2)));
        assert!(tape.backward(middle).get(unused).is_none());
    }

    #[test]
    #[should_panic(expected = "sqrt [1, 1, 1, 2]: entry [0, 0, 0, 1] of the output is NaN")]
    fn a_watched_tape_refuses_an_output_that_is_not_finite() {
        let tape = Tape::new().refusing_non_finite();
        tape.leaf(Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![4.0, -1.0])).sqrt();
    }

    #[test]
    #[should_panic(expected = "leaf [1, 1, 1, 1]: entry [0, 0, 0, 0] of the value is inf")]
    fn a_watched_tape_refuses_an_input_that_is_not_finite() {
        Tape::<f64>::new().refusing_non_finite().leaf(Tensor::scalar(f64::INFINITY));
    }

    #[test]
    #[should_panic(expected = "sqrt [1, 1, 1, 1]: entry [0, 0, 0, 0] of the gradient that it passes on is inf")]
    fn a_watched_tape_refuses_a_gradient_that_is_not_finite() {
        let tape = Tape::new().refusing_non_finite();
        tape.backward(tape.leaf(Tensor::scalar(0.0)).sqrt());
    }

    #[test]
    #[should_panic(expected = "backward: double [1, 1, 1, 1] was freed by an earlier backward_and_free")]
    fn a_second_backward_of_what_was_freed_is_refused() {
        let tape = Tape::new();
        let trunk = double(tape.leaf(Tensor::scalar(1.0)));
        let (first, second) = (double(trunk), trunk.scale(3.0));
        tape.backward_and_free(first);
        tape.backward(second);
    }

    #[test]
    fn values_are_freed_while_the_gradient_walks_back() {
        let tape = Tape::<f64>::new();
        let pool = tape.pool().clone();
        let seen = Arc::new(Mutex::new(Vec::new()));
        let mut y = tape.leaf(Tensor::zeros(Shape::new(1, 1, 32, 32)));
        for _ in 0..10 {
            let (seen, pool, x) = (seen.clone(), pool.clone(), y.exp());
            y = tape.push("watch", x.value(), &[x], move |g, grads| {
                seen.lock().unwrap().push(pool.elements());
                grads.slot(0).expect("x is differentiated").add_tensor(g);
            });
        }
        tape.backward_and_free(y.sum());
        let seen = seen.lock().unwrap();
        assert!(seen.len() == 10 && seen[9] >= seen[0] + 8 * 1024, "elements back in the pool: {seen:?}");
    }

    #[test]
    fn a_released_value_is_back_in_the_pool_unless_a_rule_keeps_it() {
        let tape = Tape::<f64>::new();
        let x = tape.leaf(Tensor::full(Shape::new(1, 1, 32, 32), 0.5));
        let sum = x.add(x);
        let y = sum.last_use(|sum| sum.relu());
        assert_eq!(tape.pool().elements(), 1024, "the rectifier keeps its output only");
        let z = y.last_use(|y| y.square());
        assert_eq!(tape.pool().elements(), 0, "the square keeps its input, and has the sum's buffer");
        assert_eq!(tape.backward_and_free(z.sum()).wrt(x).data()[0], 4.0);
    }

    #[test]
    #[should_panic(expected = "value of add [1, 1, 1, 1] was freed by backward_and_free or release")]
    fn a_released_value_says_so() {
        let tape = Tape::<f64>::new();
        let x = tape.leaf(Tensor::scalar(3.0));
        let sum = x.add(x);
        sum.release();
        sum.value();
    }

    #[test]
    #[should_panic(expected = "was freed by backward_and_free")]
    fn a_freed_value_says_so() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::scalar(3.0));
        let y = double(x);
        tape.backward_and_free(double(y));
        y.value();
    }
}

//! Integrals of smooth functions by Gauss-Legendre nodes on equal pieces of the interval: the same points on every run.

/// Nodes a piece. Polynomials up to degree 39 are integrated exactly.
const NODES: usize = 20;

/// A rule of 20 nodes on `[-1, 1]`.
#[derive(Clone, Debug, PartialEq)]
pub struct GaussLegendre {
    nodes: [f64; NODES],
    weights: [f64; NODES],
}

impl Default for GaussLegendre {
    fn default() -> Self {
        Self::new()
    }
}

impl GaussLegendre {
    /// Finds the nodes, the zeros of the Legendre polynomial `P_20`, by Newton's method; weights `2 / ((1 - x^2) P_20'(x)^2)`.
    #[must_use]
    pub fn new() -> Self {
        let (mut nodes, mut weights) = ([0.0; NODES], [0.0; NODES]);
        for i in 0..NODES {
            let mut x = -(std::f64::consts::PI * (i as f64 + 0.75) / (NODES as f64 + 0.5)).cos();
            // The start is good to three digits; each step doubles them.
            for _ in 0..6 {
                let (value, slope) = legendre(x);
                x -= value / slope;
            }
            let (_, slope) = legendre(x);
            nodes[i] = x;
            weights[i] = 2.0 / ((1.0 - x * x) * slope * slope);
        }
        Self { nodes, weights }
    }

    /// `int_a^b f(x) dx` over `pieces` equal pieces.
    ///
    /// **Domain**: `f` smooth inside `(a, b)`; cut the interval at kinks.
    #[must_use]
    pub fn integral(&self, a: f64, b: f64, pieces: usize, f: impl Fn(f64) -> f64) -> f64 {
        let half = 0.5 * (b - a) / pieces as f64;
        let piece = |i: usize| {
            let middle = a + half * (2 * i + 1) as f64;
            self.nodes.iter().zip(&self.weights).map(|(x, w)| w * f(middle + half * x)).sum::<f64>()
        };
        half * (0..pieces).map(piece).sum::<f64>()
    }
}

/// `P_20` and its derivative at `x` inside `(-1, 1)`, by the three-term recurrence.
fn legendre(x: f64) -> (f64, f64) {
    let (mut before, mut value) = (1.0, x);
    for n in 2..=NODES {
        let k = n as f64;
        (before, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k);
    }
    (value, NODES as f64 * (before - x * value) / (1.0 - x * x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_up_to_degree_39_are_exact() {
        let rule = GaussLegendre::new();
        for degree in 0..40 {
            let exact = if degree % 2 == 0 { 2.0 / f64::from(degree + 1) } else { 0.0 };
            let found = rule.integral(-1.0, 1.0, 1, |x| x.powi(degree));
            assert!((found - exact).abs() < 2e-15, "{degree}: {found} {exact}");
        }
        let missed = rule.integral(-1.0, 1.0, 1, |x| x.powi(40)) - 2.0 / 41.0;
        assert!(missed.abs() > 1e-13, "degree 40 must not be exact: {missed}");
    }

    #[test]
    fn known_integrals_on_any_interval() {
        let rule = GaussLegendre::default();
        assert!((rule.integral(0.0, 3.0, 2, f64::exp) - (3f64.exp() - 1.0)).abs() < 1e-14);
        assert!((rule.integral(1.0, 9.0, 4, |x| 1.0 / x) - 9f64.ln()).abs() < 1e-14);
        assert!((rule.integral(2.0, -1.0, 3, f64::cos) - ((-1f64).sin() - 2f64.sin())).abs() < 1e-14);
    }
}

//! The optimizers Adam and Adan, for the nine numbers of each Gaussian.

/// Numbers of one Gaussian: two of its position, three of its shape, four of its colour.
pub(super) const NUMBERS: usize = 9;

/// Keeps quotients finite in both optimizers.
const EPSILON: f32 = 1e-8;

/// Adam (Kingma and Ba, 2015) with PyTorch's constants.
#[derive(Debug, Default)]
pub(super) struct Adam {
    memory: Vec<[[f32; 2]; NUMBERS]>,
    steps: i32,
}

impl Adam {
    pub(super) fn new(count: usize) -> Self {
        Adam { memory: vec![[[0.0; 2]; NUMBERS]; count], steps: 0 }
    }

    /// Drops the state of Gaussians that are not `kept`.
    pub(super) fn keep(&mut self, kept: &[bool]) {
        let mut each = kept.iter();
        self.memory.retain(|_| each.next().is_some_and(|k| *k));
    }

    /// Adds empty state for new Gaussians.
    pub(super) fn add(&mut self, count: usize) {
        self.memory.resize(self.memory.len() + count, [[0.0; 2]; NUMBERS]);
    }

    /// Clears the state of one of the numbers.
    pub(super) fn forget(&mut self, number: usize) {
        self.memory.iter_mut().for_each(|m| m[number] = [0.0; 2]);
    }

    /// Moves every Gaussian by its gradient; `rates` are those of the nine numbers.
    pub(super) fn step(&mut self, numbers: &mut [[f32; NUMBERS]], gradients: &[[f32; NUMBERS]], rates: [f32; NUMBERS]) {
        const BETAS: [f32; 2] = [0.9, 0.999];
        self.steps += 1;
        let corrections = BETAS.map(|b| 1.0 - b.powi(self.steps));
        for ((p, g), memory) in numbers.iter_mut().zip(gradients).zip(&mut self.memory) {
            for k in 0..NUMBERS {
                let [m, v] = &mut memory[k];
                *m = BETAS[0] * *m + (1.0 - BETAS[0]) * g[k];
                *v = BETAS[1] * *v + (1.0 - BETAS[1]) * g[k] * g[k];
                p[k] -= rates[k] * (*m / corrections[0]) / ((*v / corrections[1]).sqrt() + EPSILON);
            }
        }
    }
}

/// Adan (Xie et al., 2022; arXiv 2208.06677) without weight decay.
#[derive(Debug)]
pub(super) struct Adan {
    /// Means of the gradient, of its changes and of the squares, and the previous gradient.
    memory: Vec<[[f32; 4]; NUMBERS]>,
    steps: i32,
}

impl Adan {
    pub(super) fn new(count: usize) -> Self {
        Adan { memory: vec![[[0.0; 4]; NUMBERS]; count], steps: 0 }
    }

    /// Moves every Gaussian by its gradient.
    pub(super) fn step(&mut self, numbers: &mut [[f32; NUMBERS]], gradients: &[[f32; NUMBERS]], rate: f32) {
        const BETAS: [f32; 3] = [0.98, 0.92, 0.99];
        self.steps += 1;
        let is_first = self.steps == 1;
        let corrections = BETAS.map(|b| 1.0 - b.powi(self.steps));
        for ((p, g), memory) in numbers.iter_mut().zip(gradients).zip(&mut self.memory) {
            for k in 0..NUMBERS {
                let [mean, change, square, before] = &mut memory[k];
                let difference = if is_first { 0.0 } else { g[k] - *before };
                let ahead = g[k] + BETAS[1] * difference;
                *mean = BETAS[0] * *mean + (1.0 - BETAS[0]) * g[k];
                *change = BETAS[1] * *change + (1.0 - BETAS[1]) * difference;
                *square = BETAS[2] * *square + (1.0 - BETAS[2]) * ahead * ahead;
                *before = g[k];
                let size = square.sqrt() / corrections[2].sqrt() + EPSILON;
                p[k] -= rate * (*mean / corrections[0] + BETAS[1] * *change / corrections[1]) / size;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_steps_are_as_long_as_the_rate_against_the_gradient() {
        let gradients = [[3.0, -0.2, 1.0, 0.0, 1e3, -1e-3, 5.0, 5.0, 5.0]];
        let (mut adam, mut adan) = ([[0.0; NUMBERS]], [[0.0; NUMBERS]]);
        Adam::new(1).step(&mut adam, &gradients, [0.1; NUMBERS]);
        Adan::new(1).step(&mut adan, &gradients, 0.1);
        for k in 0..NUMBERS {
            let want = if gradients[0][k] == 0.0 { 0.0 } else { -0.1 * gradients[0][k].signum() };
            assert!((adam[0][k] - want).abs() < 1e-5 && (adan[0][k] - want).abs() < 1e-5, "{k}: {adam:?} {adan:?}");
        }
    }

    /// Gradients 1, 3: computed by hand from the paper's equations.
    #[test]
    fn the_second_step_of_adan_sees_the_change_of_the_gradient() {
        let (mut adan, mut p) = (Adan::new(1), [[0.0f32; NUMBERS]]);
        adan.step(&mut p, &[[1.0; NUMBERS]], 0.1);
        let first = p[0][0];
        adan.step(&mut p, &[[3.0; NUMBERS]], 0.1);
        let mean = (0.98 * 0.02 + 0.02 * 3.0) / (1.0 - 0.98f32.powi(2));
        let change = 0.08 * 2.0 / (1.0 - 0.92f32.powi(2));
        let square = (0.99 * 0.01 + 0.01 * (3.0f32 + 0.92 * 2.0).powi(2)) / (1.0 - 0.99f32.powi(2));
        let want = 0.1 * (mean + 0.92 * change) / square.sqrt();
        assert!((first - p[0][0] - want).abs() < 1e-5, "{} {want}", first - p[0][0]);
    }
}

use wire::LATENT;

use super::folder::Folder;
use super::ledger::Ledger;
use crate::VerifyError;

/// Scales s of the kernels' C = 2 · 32 · s.
const SCALES: [f64; 7] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0];

/// The divergences that pull the posterior to N(0, I).
pub(super) fn compare(folder: &Folder, ledger: &mut Ledger<'_>) -> Result<(), VerifyError> {
    let posterior = folder.rows::<LATENT>("loss.posterior")?;
    let prior = folder.rows::<LATENT>("loss.prior")?;
    for (name, sigma) in [("loss.kl_sigma_1", 1.0), ("loss.kl_sigma_0.5", 0.5)] {
        let values: Vec<f32> = posterior.iter().map(|mean| kl(mean, sigma)).collect();
        ledger.compare(name, &values)?;
    }
    ledger.compare("loss.mmd", &[mmd(&posterior, &prior)])
}

/// KL(N(m, σ²I) ‖ N(0, I)) = ½ (‖m‖² + d (σ² − 1 − ln σ²)).
fn kl(mean: &[f32; LATENT], sigma: f64) -> f32 {
    let square: f64 = mean.iter().map(|m| f64::from(*m).powi(2)).sum();
    let variance = sigma * sigma;
    (0.5 * (square + LATENT as f64 * (variance - 1.0 - variance.ln()))) as f32
}

/// MMD², unbiased, with the sum of inverse multiquadric kernels C / (C + ‖a − b‖²).
fn mmd(posterior: &[[f32; LATENT]], prior: &[[f32; LATENT]]) -> f32 {
    let within = |set: &[[f32; LATENT]]| {
        let pairs = (set.len() * set.len().saturating_sub(1)).max(1) as f64;
        let rest = |i: usize| set.iter().enumerate().filter(move |(j, _)| *j != i);
        set.iter().enumerate().flat_map(|(i, a)| rest(i).map(move |(_, b)| kernel(a, b))).sum::<f64>() / pairs
    };
    let across: f64 = posterior.iter().flat_map(|a| prior.iter().map(move |b| kernel(a, b))).sum();
    let pairs = (posterior.len() * prior.len()).max(1) as f64;
    (within(posterior) + within(prior) - 2.0 * across / pairs) as f32
}

fn kernel(a: &[f32; LATENT], b: &[f32; LATENT]) -> f64 {
    let square: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    SCALES.iter().map(|s| 2.0 * LATENT as f64 * s).map(|c| c / (c + square)).sum()
}

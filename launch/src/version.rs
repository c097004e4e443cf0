use nn::{Precision, Weights};
use run::Run;
use wire::StageId;

/// Returns the version of the program, the SHA-256 of the embedded weights and the kernels of this CPU, which
/// determine the results. The last line names the licences of the weights' training data.
pub fn text() -> String {
    let weights = Weights::onboard();
    let licences = weights.licences().into_iter().map(|(data, licence)| format!("{data} ({licence})"));
    format!(
        "stgdat {}\nweights {}\nkernels {}\nweights trained on {}\n",
        env!("CARGO_PKG_VERSION"),
        weights.sha256(),
        nn::kernels::active().name(),
        licences.collect::<Vec<_>>().join(", ")
    )
}

/// Returns the precision in which a run's stages multiply, unless all of them use f32.
pub fn precision(run: &Run) -> Option<String> {
    // The options of an external program are unknown.
    run.stage(StageId::Decoder).filter(|stage| stage.built_in)?;
    let precision = decoder::STAGE.options(run).ok()?.precision;
    (precision != Precision::F32).then(|| format!("decoder in {precision}"))
}

/// Returns the kernels of this process and the precision of a run's stages, which determine the results.
pub fn kernels(run: &Run) -> String {
    let kernels = nn::kernels::active().name().to_owned();
    precision(run).map_or(kernels.clone(), |precision| format!("{kernels}, {precision}"))
}

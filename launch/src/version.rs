use nn::{Precision, Weights};
use run::Run;
use wire::StageId;

/// Returns the version of the program, the SHA-256 of the embedded weights and the kernels of this CPU. All
/// three determine the results.
pub fn text() -> String {
    format!(
        "stgdat {}\nweights {}\nkernels {}\n",
        env!("CARGO_PKG_VERSION"),
        Weights::onboard().sha256(),
        nn::kernels::active().name()
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

use nn::Weights;

/// Version of the program, SHA-256 of the embedded weights and the kernels of this CPU, which decide its
/// numbers.
pub fn text() -> String {
    format!(
        "stgdat {}\nweights {}\nkernels {}\n",
        env!("CARGO_PKG_VERSION"),
        Weights::onboard().sha256(),
        nn::kernels::active().name()
    )
}

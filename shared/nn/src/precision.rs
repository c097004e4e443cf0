use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

wire::named! {
    /// The number format of the layers' factors; sums are always f32.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
    #[serde(rename_all = "lowercase")]
    pub enum Precision {
        /// Single precision: the same bits on AVX2, AVX-512 and NEON.
        #[default]
        F32 => "f32",
        /// The upper half of f32, with 8 significant bits, if the processor has dot products for it (AVX-512
        /// BF16).
        Bf16 => "bf16",
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

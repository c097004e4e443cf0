//! Checks the machine code of the hot loops with objdump: sums stay in their registers.
//!
//! A register tile may be one sum too large, or the compiler may not understand a loop's shape. The results
//! are then still right, but take twice the time. The sums then move between registers, or to the stack and
//! back, in each step.

#![expect(clippy::unwrap_used, reason = "a test ends at what it can't read")]

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;
use std::time::Duration;

use nn::kernels::peak;
use nn::{Decoder, Precision, Weights};

/// A loop with fewer multiply-adds is the remainder of another.
const MULTIPLY_ADDS_MIN: usize = 4;

/// An innermost loop with multiply-adds.
struct Loop<'a> {
    instructions: &'a [(u64, String)],
}

impl Loop<'_> {
    fn lines(&self) -> impl Iterator<Item = &str> {
        self.instructions.iter().map(|(_, text)| text.as_str())
    }

    fn text(&self) -> String {
        self.lines().collect::<Vec<_>>().join("\n")
    }

    fn multiply_adds(&self) -> impl Iterator<Item = &str> {
        self.lines().filter(|line| line.starts_with("vfmadd") || line.starts_with("vdpbf16ps"))
    }

    /// Number of registers that accumulate multiply-adds.
    fn sum_count(&self) -> usize {
        let register = |line: &str| line.split_whitespace().nth(1)?.split(',').next().map(str::to_owned);
        self.multiply_adds().filter_map(register).collect::<BTreeSet<_>>().len()
    }

    /// Whether the loop only multiplies and adds; loops with exponentials need copies.
    fn is_of_the_product_or_the_peak(&self) -> bool {
        let mut lines = self.lines();
        self.multiply_adds().count() >= MULTIPLY_ADDS_MIN
            && !lines.any(|line| ["vdiv", "vmin", "vpslld"].iter().any(|other| line.starts_with(other)))
    }
}

fn is_vector(operand: &str) -> bool {
    ["xmm", "ymm", "zmm"].iter().any(|kind| operand.trim_start().starts_with(kind))
}

/// Whether an instruction copies one vector register to another.
fn is_copy(line: &str) -> bool {
    let Some((name, operands)) = line.split_once(char::is_whitespace) else { return false };
    name.starts_with("vmov") && operands.split(',').count() == 2 && operands.split(',').all(is_vector)
}

/// Whether an instruction moves a vector to or from the stack.
fn is_spill(line: &str) -> bool {
    let Some((name, operands)) = line.split_once(char::is_whitespace) else { return false };
    // A broadcast of one number is not a spilled vector, wherever it is.
    name.starts_with('v')
        && operands.contains("[rsp")
        && !name.starts_with("vbroadcast")
        && operands.split(',').any(is_vector)
}

/// The instructions of each function of this executable whose name contains all of `parts`: address and text.
fn disassemble(parts: &[&str]) -> Option<Vec<Vec<(u64, String)>>> {
    let this = std::env::current_exe().unwrap();
    let arguments = ["--disassemble", "--no-show-raw-insn", "--wide", "-M", "intel"];
    let output = Command::new("objdump").args(arguments).arg(this).output().ok()?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut functions = BTreeMap::new();
    let mut name = None;
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        if line.ends_with(">:") {
            name = Some(line.to_owned()).filter(|line| parts.iter().all(|part| line.contains(part)));
        } else if let (Some(name), Some((address, text))) = (&name, line.split_once(":\t")) {
            let address = u64::from_str_radix(address.trim(), 16).unwrap();
            let function: &mut Vec<_> = functions.entry(name.clone()).or_default();
            function.push((address, text.trim().to_owned()));
        }
    }
    Some(functions.into_values().collect())
}

/// The innermost loops of a function.
fn innermost(function: &[(u64, String)]) -> Vec<Loop<'_>> {
    let target = |text: &str| {
        let (name, operands) = text.split_once(char::is_whitespace)?;
        let address = operands.split_whitespace().next()?;
        name.starts_with('j').then(|| u64::from_str_radix(address, 16).ok()).flatten()
    };
    let jumps = function.iter().enumerate().filter_map(|(place, (_, text))| Some((place, target(text)?)));
    let mut loops = Vec::new();
    for (last, target) in jumps.clone() {
        let first = function.partition_point(|&(address, _)| address < target);
        let has_jump = jumps.clone().any(|(place, _)| (first..last).contains(&place));
        if first <= last && function[first].0 == target && !has_jump {
            loops.push(Loop { instructions: &function[first..=last] });
        }
    }
    loops
}

/// Checks the loops of an instruction set. At least `loop_count` of them must have `sum_count` sums.
fn check(set: &str, sum_count: usize, loop_count: usize) {
    let Some(functions) = disassemble(&["kernels", set]) else {
        testing::skip("no objdump");
        return;
    };
    let loops = functions.iter().flat_map(|function| innermost(function));
    let hot: Vec<Loop<'_>> = loops.filter(Loop::is_of_the_product_or_the_peak).collect();
    for hot in &hot {
        assert!(!hot.lines().any(is_copy), "{set} copies a register in\n{}", hot.text());
        assert!(!hot.lines().any(is_spill), "{set} spills in\n{}", hot.text());
    }
    let whole = hot.iter().filter(|hot| hot.sum_count() >= sum_count).count();
    assert!(whole >= loop_count, "{set} has {whole} loops of {sum_count} sums among {}", hot.len());
    println!("{set}: {} hot loops, {whole} of them with {sum_count} sums or more", hot.len());
}

#[test]
fn hot_loops_neither_spill_nor_copy_registers() {
    // objdump shows linked code only: these calls link the loops.
    assert!(peak::fma_gflops(Duration::ZERO) > 0.0 && peak::product_gflops(Duration::ZERO) > 0.0);
    // Refused if the processor lacks it, but still linked.
    let _ = Decoder::with_precision(&Weights::onboard(), Precision::Bf16);
    if cfg!(debug_assertions) || !cfg!(target_arch = "x86_64") {
        testing::skip("this needs an optimised build for x86-64");
        return;
    }
    // The peak, and the products of rows, of columns and of taps.
    check("avx2", 12, 4);
    check("avx512", 24, 4);
    check("bf16", 24, 1);
}

#[test]
fn copies_and_spills_are_told_from_other_instructions() {
    for line in ["vmovaps ymm1,ymm2", "vmovups zmm1,zmm20", "vmovdqa64 zmm1,zmm2"] {
        assert!(is_copy(line), "{line}");
    }
    for line in ["vmovups ymm1,YMMWORD PTR [rsi]", "vmovups YMMWORD PTR [rsp+0x20],ymm1", "mov rax,rbx"] {
        assert!(!is_copy(line), "{line}");
    }
    for line in ["vmovups YMMWORD PTR [rsp+0x20],ymm1", "vfmadd231ps ymm0,ymm1,YMMWORD PTR [rsp+rax*4]"] {
        assert!(is_spill(line), "{line}");
    }
    for line in
        ["vbroadcastss ymm1,DWORD PTR [rsp]", "mov rax,QWORD PTR [rsp+0x8]", "vmovups ymm1,YMMWORD PTR [rsi]"]
    {
        assert!(!is_spill(line), "{line}");
    }
}

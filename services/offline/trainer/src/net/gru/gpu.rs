//! The recurrent unit over the horizon on a GPU.
//!
//! The small products of the first step with ṽ and z run on the processor; all steps of all draws are one
//! dispatch forward and one backward, and the gradients by W_h and the head another. The trace for the
//! backward pass stays on the GPU.

use std::sync::mpsc;

use wgpu::util::{BufferInitDescriptor, DeviceExt};

use super::super::matrix::Matrix;
use super::super::tensors::{Gradients, Tensors};
use super::CONTROL;
use super::step::{GATES, HIDDEN};
use super::unroll::{First, Inputs, STACKED, UnrollGradients, stacked};
use crate::TrainError;

/// Rows of a workgroup of the kernels over the horizon.
const ROWS: usize = 8;
/// Side of the results of a workgroup of the sum of products.
const TILE: usize = 16;
/// Columns of the gradients of a step: by H, by the head's output, by Iₙ.
const COLUMNS: usize = STACKED + HIDDEN;

/// A GPU with the kernels of the recurrent unit.
#[derive(Debug)]
pub(crate) struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    forward: wgpu::ComputePipeline,
    backward: wgpu::ComputePipeline,
    sum: wgpu::ComputePipeline,
    name: String,
}

/// What the backward pass needs, on the GPU.
#[derive(Debug)]
pub(crate) struct Trace {
    inputs: Inputs,
    horizon_len: usize,
    gates: wgpu::Buffer,
    states: wgpu::Buffer,
}

impl Gpu {
    /// Opens the system's high-performance GPU.
    pub(crate) fn open() -> Result<Self, TrainError> {
        let instance = wgpu::Instance::default();
        let wanted = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..Default::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&wanted))
            .map_err(|error| TrainError::Gpu { source: error.into() })?;
        let descriptor = wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| TrainError::Gpu { source: error.into() })?;
        let pipeline = |label: &str, parts: &[&str]| {
            let source = sizes() + &parts.concat();
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(label),
                source: wgpu::ShaderSource::Wgsl(source.into()),
            });
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(label),
                layout: None,
                module: &module,
                entry_point: None,
                compilation_options: Default::default(),
                cache: None,
            })
        };
        let info = adapter.get_info();
        Ok(Self {
            forward: pipeline(
                "forward",
                &[include_str!("gpu/horizon.wgsl"), include_str!("gpu/forward.wgsl")],
            ),
            backward: pipeline(
                "backward",
                &[include_str!("gpu/horizon.wgsl"), include_str!("gpu/backward.wgsl")],
            ),
            sum: pipeline("sum", &[include_str!("gpu/sum.wgsl")]),
            name: format!("{} ({})", info.name, info.backend),
            device,
            queue,
        })
    }

    /// Name and backend.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// The same as [`super::unroll`], with the inputs where the trace is to be kept.
    pub(super) fn unroll(
        &self,
        weights: &Tensors,
        (name, hidden, draws_len): (&str, &Matrix, usize),
        first_input: &[f32],
        horizon_len: usize,
        inputs: Option<Inputs>,
    ) -> (Matrix, Option<Trace>) {
        let (rows_len, keep_trace) = (hidden.rows * draws_len, inputs.is_some());
        let weight = turned(&stacked(weights, name, "weight"));
        let bias =
            [&stacked(weights, name, "bias")[..], weights.get(&format!("{name}.gru.bias_ih"))].concat();
        let [gates, states] = [(horizon_len, 4 * HIDDEN), (horizon_len + 1, HIDDEN)]
            .map(|(steps, cols)| self.empty(if keep_trace { steps * rows_len * cols } else { 1 }));
        let raw = self.empty(rows_len * horizon_len * CONTROL);
        let size = self.uniform([rows_len, draws_len, horizon_len, usize::from(keep_trace)]);
        let [weight, bias, input, hidden] =
            [&weight[..], &bias, first_input, &hidden.values].map(|values| self.filled(values));
        let buffers = [&size, &weight, &bias, &input, &hidden, &raw, &gates, &states];
        self.run(&self.forward, &buffers, [rows_len.div_ceil(ROWS) as u32, 1]);
        let raw =
            Matrix::new(rows_len, horizon_len * CONTROL, self.read(&raw, rows_len * horizon_len * CONTROL));
        (raw, inputs.map(|inputs| Trace { inputs, horizon_len, gates, states }))
    }

    /// The same as [`super::Unroll::backward`].
    pub(super) fn backward(
        &self,
        trace: &Trace,
        weights: &Tensors,
        gradients: &mut Gradients,
        d_raw: &Matrix,
    ) -> UnrollGradients {
        let Trace { inputs, horizon_len, gates, states } = trace;
        let (rows_len, states_len, name) = (d_raw.rows, horizon_len + 1, &inputs.name);
        let weight = self.filled(&stacked(weights, name, "weight"));
        let size = self.uniform([rows_len, inputs.draws_len(), *horizon_len, 0]);
        let d_raw = self.filled(&d_raw.values);
        let d = self.empty(states_len * rows_len * COLUMNS);
        let d_hidden = self.empty(rows_len * HIDDEN);
        let buffers = [&size, &weight, gates, states, &d_raw, &d, &d_hidden];
        self.run(&self.backward, &buffers, [rows_len.div_ceil(ROWS) as u32, 1]);

        let size = self.uniform([states_len * rows_len, COLUMNS, HIDDEN, 0]);
        let sum = self.empty(COLUMNS * (HIDDEN + 1));
        let groups = [HIDDEN + 1, COLUMNS].map(|len| len.div_ceil(TILE) as u32);
        self.run(&self.sum, &[&size, &d, states, &sum], groups);
        add_sums(gradients, name, &self.read(&sum, COLUMNS * (HIDDEN + 1)));

        let first = self.read(&d, rows_len * COLUMNS);
        let mut d_input = Vec::with_capacity(rows_len * GATES);
        for row in first.chunks_exact(COLUMNS) {
            d_input.extend_from_slice(&row[..2 * HIDDEN]);
            d_input.extend_from_slice(&row[STACKED..]);
        }
        let d_hidden = Matrix::new(rows_len, HIDDEN, self.read(&d_hidden, rows_len * HIDDEN));
        let d_input = Matrix::new(rows_len, GATES, d_input);
        First { d_state: d_hidden, d_recurrent: None, d_input }.backward(weights, gradients, inputs)
    }

    fn run(&self, pipeline: &wgpu::ComputePipeline, buffers: &[&wgpu::Buffer], groups: [u32; 2]) {
        let entries: Vec<_> = (0..)
            .zip(buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let bound = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &bound, &[]);
        pass.dispatch_workgroups(groups[0], groups[1], 1);
        drop(pass);
        self.queue.submit([encoder.finish()]);
    }

    /// A buffer of `len` floats.
    fn empty(&self, len: usize) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: 4 * len as u64,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        })
    }

    fn filled(&self, values: &[f32]) -> wgpu::Buffer {
        let usage = wgpu::BufferUsages::STORAGE;
        self.device.create_buffer_init(&BufferInitDescriptor {
            label: None,
            contents: bytemuck::cast_slice(values),
            usage,
        })
    }

    fn uniform(&self, sizes: [usize; 4]) -> wgpu::Buffer {
        let sizes = sizes.map(|size| size as u32);
        let usage = wgpu::BufferUsages::UNIFORM;
        self.device.create_buffer_init(&BufferInitDescriptor {
            label: None,
            contents: bytemuck::cast_slice(&sizes),
            usage,
        })
    }

    /// The first `len` floats of a buffer.
    ///
    /// # Panics
    /// Where the GPU is lost.
    fn read(&self, buffer: &wgpu::Buffer, len: usize) -> Vec<f32> {
        let size = 4 * len as u64;
        let near = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer, 0, &near, 0, size);
        self.queue.submit([encoder.finish()]);
        let (sender, receiver) = mpsc::channel();
        near.map_async(wgpu::MapMode::Read, .., move |mapped| {
            // The receiver lives until the callback has run.
            let _ = sender.send(mapped);
        });
        self.device.poll(wgpu::PollType::wait_indefinitely()).expect("the GPU answers");
        receiver.recv().expect("the mapping ends").expect("the GPU's memory is readable");
        let mapped = near.get_mapped_range(..).expect("the whole buffer is mapped");
        bytemuck::cast_slice(&mapped).to_vec()
    }
}

/// The sizes that the kernels share with the processor, as WGSL constants.
fn sizes() -> String {
    let sizes = [
        ("HIDDEN", HIDDEN),
        ("GATES", GATES),
        ("CONTROL", CONTROL),
        ("STACKED", STACKED),
        ("COLUMNS", COLUMNS),
        ("ROWS", ROWS),
        ("TILE", TILE),
    ];
    sizes.iter().map(|(name, size)| format!("const {name}: u32 = {size}u;\n")).collect()
}

/// A matrix `[389, 128]` as `[128, 389]`.
fn turned(matrix: &[f32]) -> Vec<f32> {
    (0..HIDDEN).flat_map(|k| (0..STACKED).map(move |out| matrix[out * HIDDEN + k])).collect()
}

/// Adds the gradients by W_h, the head and all biases, `[517, 128 + 1]` with the sums of the rows in the last
/// column.
fn add_sums(gradients: &mut Gradients, name: &str, sums: &[f32]) {
    let (rows, _) = sums.as_chunks::<{ HIDDEN + 1 }>();
    let mut add = |part: &str, rows: &mut dyn Iterator<Item = &[f32]>| {
        let gradient = gradients.get_mut(&format!("{name}.{part}")).iter_mut();
        gradient.zip(rows.flatten()).for_each(|(sum, value)| *sum += value);
    };
    let bias = |row: &'_ [f32; HIDDEN + 1]| row[HIDDEN];
    add("gru.weight_hh", &mut rows[..GATES].iter().map(|row| &row[..HIDDEN]));
    add("head.weight", &mut rows[GATES..STACKED].iter().map(|row| &row[..HIDDEN]));
    let by_state: Vec<f32> = rows[..GATES].iter().map(bias).collect();
    let head: Vec<f32> = rows[GATES..STACKED].iter().map(bias).collect();
    let by_input: Vec<f32> = rows[..2 * HIDDEN].iter().chain(&rows[STACKED..]).map(bias).collect();
    add("gru.bias_hh", &mut std::iter::once(&by_state[..]));
    add("gru.bias_ih", &mut std::iter::once(&by_input[..]));
    add("head.bias", &mut std::iter::once(&head[..]));
}

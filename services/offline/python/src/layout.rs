//! The layouts of records, as numpy's dtypes describe them.

use std::collections::BTreeMap;

use pyo3::IntoPyObjectExt as _;
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use wire::{Primitive, Record, TABLE, Type, Value};

/// The layout of the leading bytes of a record, as the argument of `numpy.dtype`. Only whole fields have a
/// place in it.
#[pyfunction]
pub fn layout<'py>(
    py: Python<'py>,
    record: &str,
    leading_bytes: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let topic = TABLE.topics.iter().find(|topic| topic.name == record).map(|topic| topic.element);
    let found = topic.or_else(|| TABLE.records.iter().find(|other| other.name == record));
    let found = found.ok_or_else(|| PyKeyError::new_err(record.to_owned()))?;
    of_record(py, found, leading_bytes.unwrap_or(found.size))
}

fn of_record<'py>(py: Python<'py>, record: &Record, bytes: usize) -> PyResult<Bound<'py, PyDict>> {
    let fields = || record.fields.iter().filter(|field| field.offset + field.r#type.size() <= bytes);
    let formats: Vec<Bound<'py, PyAny>> =
        fields().map(|field| of_type(py, &field.r#type)).collect::<PyResult<_>>()?;
    let layout = PyDict::new(py);
    layout.set_item("names", fields().map(|field| field.name).collect::<Vec<_>>())?;
    layout.set_item("formats", formats)?;
    layout.set_item("offsets", fields().map(|field| field.offset).collect::<Vec<_>>())?;
    layout.set_item("itemsize", bytes)?;
    Ok(layout)
}

fn of_type<'py>(py: Python<'py>, of: &Type) -> PyResult<Bound<'py, PyAny>> {
    let mut shape = Vec::new();
    let mut inner = of;
    while let Type::Array(element, len) = inner {
        shape.push(*len);
        inner = element;
    }
    let format = match inner {
        Type::Record(record) => of_record(py, record, record.size)?.into_any(),
        Type::Primitive(primitive) => name(*primitive).into_bound_py_any(py)?,
        Type::Array(..) => unreachable!("the loop ends at another type"),
    };
    if shape.is_empty() {
        return Ok(format);
    }
    let shape = pyo3::types::PyTuple::new(py, shape)?;
    (format, shape).into_bound_py_any(py)
}

const fn name(primitive: Primitive) -> &'static str {
    match primitive {
        Primitive::U8 => "<u1",
        Primitive::U16 => "<u2",
        Primitive::U32 => "<u4",
        Primitive::U64 => "<u8",
        Primitive::I64 => "<i8",
        Primitive::F32 => "<f4",
    }
}

/// The named numbers of the wire: by enumeration, each number's name.
#[pyfunction]
pub fn numbers() -> BTreeMap<&'static str, BTreeMap<u32, &'static str>> {
    let of = |entries: &'static [wire::Number]| entries.iter().map(|of| (of.number, of.name)).collect();
    let mut all: BTreeMap<_, BTreeMap<u32, &'static str>> =
        TABLE.numbers.iter().map(|numbers| (numbers.name, of(numbers.entries))).collect();
    all.entry("AgentType").or_insert_with(|| {
        wire::AGENT_TYPES.iter().map(|agent_type| (*agent_type as u32, agent_type.name())).collect()
    });
    all
}

/// The whole numbers among the constants and flags of the wire, by name.
#[pyfunction]
pub fn constants() -> BTreeMap<&'static str, u64> {
    let flags = TABLE.flags.iter().flat_map(|flags| flags.bits);
    let all = TABLE.constants.iter().chain(flags);
    let whole = |value: &Value| match value {
        Value::Integer(value) => Some(*value),
        Value::Real(_) => None,
    };
    all.filter_map(|constant| Some((constant.name, whole(&constant.value)?))).collect()
}

//! Tensors to and from rows of fixed width.

use crate::{Invalid, proto::Tensor};

const BYTES: usize = size_of::<f64>();

fn from_values(shape: Vec<u32>, values: &[f64]) -> Tensor {
    Tensor {
        shape,
        data: values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect(),
    }
}

fn extent(length: usize) -> u32 {
    // Lengths far above the limits cannot be received; saturating lets the receiver say so.
    u32::try_from(length).unwrap_or(u32::MAX)
}

/// `[n]`; nothing when empty.
pub(crate) fn vector(values: &[f64]) -> Option<Tensor> {
    (!values.is_empty()).then(|| from_values(vec![extent(values.len())], values))
}

/// `[rows, W]`; nothing when there is no row.
pub(crate) fn rows<const W: usize>(rows: &[[f64; W]]) -> Option<Tensor> {
    (!rows.is_empty())
        .then(|| from_values(vec![extent(rows.len()), extent(W)], rows.as_flattened()))
}

/// `[rows, members, W]` from rows that are `members` blocks of `W`; nothing when there is no row.
pub(crate) fn blocks<const W: usize>(rows: &[Vec<[f64; W]>]) -> Option<Tensor> {
    let members = rows.first()?.len();
    let flat: Vec<f64> = rows.iter().flatten().flatten().copied().collect();
    Some(from_values(
        vec![extent(rows.len()), extent(members), extent(W)],
        &flat,
    ))
}

/// The values, once the shape has been found to be what the data hold and every value finite.
fn values(
    field: &'static str,
    tensor: &Tensor,
    accepts: impl Fn(&[usize]) -> bool,
    expected: &str,
) -> Result<Vec<f64>, Invalid> {
    let shape: Vec<usize> = tensor.shape.iter().map(|&n| n as usize).collect();
    if !accepts(&shape) {
        return Err(Invalid::field(
            field,
            format!("expected shape {expected}, got {shape:?}"),
        ));
    }
    // Shapes were bounded by `accepts`, so the product cannot overflow.
    let needed = shape.iter().product::<usize>() * BYTES;
    if tensor.data.len() != needed {
        let actual = tensor.data.len();
        return Err(Invalid::field(
            field,
            format!("shape {shape:?} needs {needed} bytes of data, got {actual}"),
        ));
    }
    let (chunks, _) = tensor.data.as_chunks::<BYTES>();
    let values: Vec<f64> = chunks
        .iter()
        .map(|&chunk| f64::from_le_bytes(chunk))
        .collect();
    match values.iter().position(|value| !value.is_finite()) {
        Some(at) => Err(Invalid::field(field, format!("value {at} is not finite"))),
        None => Ok(values),
    }
}

/// A required `[W]`.
pub(crate) fn read_array<const W: usize>(
    field: &'static str,
    tensor: Option<&Tensor>,
) -> Result<[f64; W], Invalid> {
    let tensor = tensor.ok_or_else(|| Invalid::field(field, "is required and absent"))?;
    let values = values(field, tensor, |shape| shape == [W], &format!("[{W}]"))?;
    <[f64; W]>::try_from(values).map_err(|_| Invalid::field(field, format!("expected {W} values")))
}

/// An optional `[n]` with `n <= max`; absent gives an empty one.
pub(crate) fn read_vector(
    field: &'static str,
    tensor: Option<&Tensor>,
    max: usize,
) -> Result<Vec<f64>, Invalid> {
    let Some(tensor) = tensor else {
        return Ok(Vec::new());
    };
    values(
        field,
        tensor,
        |shape| matches!(shape, [n] if (1..=max).contains(n)),
        &format!("[n] with n in 1..={max}"),
    )
}

/// An optional `[n, W]` with `n <= max`; absent gives no row.
pub(crate) fn read_rows<const W: usize>(
    field: &'static str,
    tensor: Option<&Tensor>,
    max: usize,
) -> Result<Vec<[f64; W]>, Invalid> {
    let Some(tensor) = tensor else {
        return Ok(Vec::new());
    };
    let values = values(
        field,
        tensor,
        |shape| matches!(shape, [n, width] if (1..=max).contains(n) && *width == W),
        &format!("[n, {W}] with n in 1..={max}"),
    )?;
    Ok(values.as_chunks().0.to_vec())
}

/// An optional `[n, members, W]` with `n <= max_rows`, `members <= max_members`; absent gives no row.
pub(crate) fn read_blocks<const W: usize>(
    field: &'static str,
    tensor: Option<&Tensor>,
    max_rows: usize,
    max_members: usize,
) -> Result<Vec<Vec<[f64; W]>>, Invalid> {
    let Some(tensor) = tensor else {
        return Ok(Vec::new());
    };
    let values = values(
        field,
        tensor,
        |shape| {
            matches!(shape, [n, members, width] if (1..=max_rows).contains(n)
                && (1..=max_members).contains(members) && *width == W)
        },
        &format!("[n, N, {W}] with n in 1..={max_rows}, N in 1..={max_members}"),
    )?;
    let members = tensor.shape.get(1).map_or(1, |&n| n as usize);
    Ok(values
        .as_chunks()
        .0
        .chunks(members)
        .map(<[_]>::to_vec)
        .collect())
}

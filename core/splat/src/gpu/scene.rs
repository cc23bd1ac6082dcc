//! The buffers of a scene on its way through the kernels, and how large they must be.

use super::arena::Store;
use super::device::Gpu;
use super::params::{BLOCK, BUCKET, GROUP, TILE};
use crate::error::SplatError;

/// What decides the sizes of buffers and dispatches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Shape {
    /// Gaussians.
    pub count: usize,
    /// Features of each.
    pub features: usize,
    /// Groups of four channels: features, depth if asked for, and transmittance.
    pub groups: usize,
    /// Picture, pixels.
    pub width: usize,
    pub height: usize,
    /// Entries that there is room for.
    pub capacity: usize,
}

impl Shape {
    /// Groups of four that hold `channels` and the transmittance.
    pub fn groups_for(channels: usize) -> usize {
        (channels + 1).div_ceil(GROUP)
    }

    /// Columns and rows of tiles.
    pub fn grid(&self) -> [usize; 2] {
        [self.width.div_ceil(TILE), self.height.div_ceil(TILE)]
    }

    /// Tiles.
    pub fn tiles(&self) -> usize {
        let [columns, rows] = self.grid();
        columns * rows
    }

    /// Pixels.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Buckets of entries that there is room for.
    pub fn buckets(&self) -> usize {
        self.capacity / BUCKET + self.tiles() + 1
    }

    /// Blocks in a row of the sort's table.
    pub fn stride(&self) -> usize {
        self.count.max(self.capacity).div_ceil(BLOCK).max(1)
    }

    /// Words of the picture and of its gradient.
    pub fn picture_words(&self) -> usize {
        GROUP * self.groups * self.pixels()
    }
}

/// All buffers; which kernel sees which is in `raster.rs`.
#[derive(Debug)]
pub(crate) struct Buffers {
    pub geometry: Store,
    pub features: Store,
    pub records: Store,
    pub payload: Store,
    /// Depth keys, then tiles; each with its other buffer.
    pub depths: [Store; 2],
    pub order: [Store; 2],
    pub tiles: [Store; 2],
    pub places: [Store; 2],
    pub owners: Store,
    pub before: Store,
    pub blocks: Store,
    pub spans: Store,
    pub table: Store,
    pub digits: Store,
    pub totals: Store,
    pub dispatches: Store,
    pub ranges: Store,
    pub entries: Store,
    pub picture: Store,
    pub gradient: Store,
    pub states: Store,
    pub buckets: Store,
    pub slots: Store,
    pub on_geometry: Store,
    pub on_features: Store,
}

impl Buffers {
    pub fn new() -> Self {
        let new = Store::new;
        Self {
            geometry: new("the scene's geometry"),
            features: new("the scene's features"),
            records: new("the projected splats"),
            payload: new("the splats' features"),
            depths: ["the depths"; 2].map(new),
            order: ["the order of depth"; 2].map(new),
            tiles: ["the list of tile entries"; 2].map(new),
            places: ["the order of tile entries"; 2].map(new),
            owners: new("the list of tile entries"),
            before: new("the counts of tile entries"),
            blocks: new("the counts of tile entries"),
            spans: new("the spans of tile entries"),
            table: new("the sort's table"),
            digits: new("the sort's digits"),
            totals: new("the totals"),
            dispatches: Store::indirect("the dispatches"),
            ranges: new("the tiles' ranges"),
            entries: new("the list of tile entries"),
            picture: new("the picture"),
            gradient: new("the picture's gradient"),
            states: new("the pixels' states"),
            buckets: new("the buckets of tile entries"),
            slots: new("the gradients of tile entries"),
            on_geometry: new("the gradients of the geometry"),
            on_features: new("the gradients of the features"),
        }
    }

    /// Room for a forward pass; whether any buffer is another than before.
    ///
    /// # Errors
    /// When the device cannot hold it.
    pub fn ensure_forward(&mut self, gpu: &Gpu, shape: &Shape) -> Result<bool, SplatError> {
        let (n, entries) = (shape.count, shape.capacity);
        let mut sizes = vec![
            (&mut self.geometry, 12 * n),
            (&mut self.features, shape.features * n),
            (&mut self.records, 8 * n),
            (&mut self.payload, GROUP * shape.groups * n),
            (&mut self.owners, entries),
            (&mut self.before, n),
            (&mut self.blocks, n.div_ceil(BLOCK)),
            (&mut self.spans, 2 * n),
            (&mut self.table, 256 * shape.stride()),
            (&mut self.digits, 256),
            (&mut self.totals, 4),
            (&mut self.dispatches, 12),
            (&mut self.ranges, 2 * shape.tiles()),
            (&mut self.entries, 2 * entries),
            (&mut self.picture, shape.picture_words()),
        ];
        sizes.extend(self.depths.iter_mut().chain(&mut self.order).map(|store| (store, n)));
        sizes.extend(self.tiles.iter_mut().chain(&mut self.places).map(|store| (store, entries)));
        ensure(gpu, sizes)
    }

    /// Room for a backward pass.
    ///
    /// # Errors
    /// When the device cannot hold it.
    pub fn ensure_backward(&mut self, gpu: &Gpu, shape: &Shape) -> Result<bool, SplatError> {
        let slot = 2 + shape.groups;
        let sizes = vec![
            (&mut self.gradient, shape.picture_words()),
            (&mut self.states, 2 * TILE * TILE * shape.buckets()),
            (&mut self.buckets, shape.buckets()),
            (&mut self.slots, GROUP * slot * shape.capacity),
            (&mut self.on_geometry, 4 * GROUP * shape.count),
            (&mut self.on_features, GROUP * shape.groups * shape.count),
        ];
        ensure(gpu, sizes)
    }
}

fn ensure(gpu: &Gpu, sizes: Vec<(&mut Store, usize)>) -> Result<bool, SplatError> {
    let mut changed = false;
    for (store, words) in sizes {
        changed |= store.ensure(gpu, words)?;
    }
    Ok(changed)
}

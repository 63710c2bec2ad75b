//! Scenes and fragments as the device takes them, and lists as it gives them back.

use crate::fragments::{Background, Fragment, Fragments, Lists};
use crate::gpu::{Given, Opaque, View};
use crate::order::{Reorderer, SubmissionOrder};
use crate::raster::{Drawn, Linear, Outline, Paint, Raster, Tile};
use crate::scene::Scene;
use rayon::prelude::*;

/// Edge of the tiles that opaque surfaces are drawn in.
const TILE: u32 = 64;

/// The device's lists as the CPU has them.
pub(super) fn lists_of(captured: &Given) -> Lists {
    let mut lists = Lists::new();
    let mut fragments = captured.keys.iter().zip(&captured.colors);
    for &count in &captured.counts {
        for (&[depth, primitive], &[r, g, b, alpha]) in fragments.by_ref().take(count as usize) {
            lists.push(Fragment { depth: f32::from_bits(depth), color: [r, g, b], alpha, primitive });
        }
        lists.end_row();
    }
    lists
}

/// Whether the scene has any opaque surface.
pub(super) fn has_opaque(scene: &Scene) -> bool {
    scene.meshes().iter().any(|mesh| !mesh.material().is_transparent())
}

/// The nearest opaque surface of every pixel, as the CPU backend draws it.
pub(super) fn opaque_surfaces(scene: &Scene, stop: &(dyn Fn() -> bool + Sync)) -> Opaque {
    let raster = Raster::new(scene, TILE, stop);
    let (width, columns) = (scene.width() as usize, raster.columns());
    let pixels = width * scene.height() as usize;
    let [r, g, b] = scene.background();
    let mut opaque = Opaque { depth: vec![f32::INFINITY; pixels], color: vec![[r, g, b, 1.0]; pixels] };
    let tiles = (0..raster.rows() * columns).into_par_iter().map_init(Tile::default, |tile, i| {
        let place = (i % columns, i / columns);
        let rect = raster.rect(place.0, place.1);
        tile.begin(&raster, place, rect, true, stop);
        let behind = tile.background();
        (rect, behind.is_any().then(|| (behind.depths().collect::<Vec<_>>(), behind.colors().to_vec())))
    });
    for (rect, surfaces) in tiles.collect::<Vec<_>>() {
        let Some((depths, colors)) = surfaces else { continue };
        for row in 0..rect.height() {
            #[expect(clippy::cast_sign_loss, reason = "tiles lie in the image")]
            let first = (rect.y0 as usize + row) * width + rect.x0 as usize;
            for (i, x) in (row * rect.width()..(row + 1) * rect.width()).zip(first..) {
                let [r, g, b] = colors[i];
                (opaque.depth[x], opaque.color[x]) = (depths[i], [r, g, b, 1.0]);
            }
        }
    }
    opaque
}

/// Fragments as the device has them before they are drawn.
pub(super) fn view_of(fragments: &Fragments) -> View {
    let (background, opaque) = match &fragments.background {
        Background::Constant(color) => (*color, None),
        Background::Image(colors) => {
            let color = colors.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect();
            ([0.0; 3], Some(Opaque { depth: vec![f32::INFINITY; colors.len()], color }))
        }
    };
    View { width: fragments.width, height: fragments.height, perspective: false, background, opaque }
}

/// Fragments in an order.
pub(super) fn reordered(fragments: &Fragments, order: SubmissionOrder) -> Lists {
    let centroids = (order == SubmissionOrder::Centroid).then(|| fragments.centroid_order());
    let mut reordered = Lists::new();
    Reorderer::default().reorder(fragments.lists.as_ref(), order, centroids.as_ref(), &mut reordered);
    reordered
}

/// Lists as the device takes them.
pub(super) fn given(lists: &Lists) -> Given {
    let lists = lists.as_ref();
    #[expect(clippy::cast_possible_truncation, reason = "a pixel's list is far shorter than 2^32")]
    let counts = (0..lists.len()).map(|pixel| lists.count(pixel) as u32).collect();
    // adding zero makes -0 the 0 that it equals
    let keys = lists.all.iter().map(|f| [(f.depth + 0.0).to_bits(), f.primitive]).collect();
    let colors = lists.all.iter().map(|f| [f.color[0], f.color[1], f.color[2], f.alpha]).collect();
    Given { counts, keys, colors }
}

/// Every fragment as a triangle that covers the centre of its pixel and no other. Of sorted ones the places stand for the
/// primitives, which may repeat themselves.
pub(super) fn points(lists: &Lists, width: u32, are_sorted: bool) -> impl Iterator<Item = Drawn<'_>> {
    const LEG: i32 = 384;
    let width = width as usize;
    let lists = lists.as_ref();
    (0..lists.len()).flat_map(move |pixel| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "pixels of an image")]
        let (x, y) = ((pixel % width) as i32, (pixel / width) as i32);
        let row = lists.row(pixel);
        (0..row.len()).map(move |i| {
            let fragment = row.get(i);
            #[expect(clippy::cast_possible_truncation, reason = "a pixel's list is far shorter than 2^32")]
            let place = i as u32;
            let (left, top) = (256 * x, 256 * y);
            let [r, g, b] = fragment.color;
            Drawn {
                primitive: if are_sorted { place } else { fragment.primitive },
                outline: Outline::Triangle([(left, top), (left + LEG, top), (left, top + LEG)]),
                anchor: (x, y),
                depth: Linear::default(),
                weights: [Linear::default(); 3],
                range: (fragment.depth.into(), fragment.depth.into()),
                paint: Paint::Flat([r, g, b, fragment.alpha]),
            }
        })
    })
}

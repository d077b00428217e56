//! What stands along a street: parked cars, trees, posts, bins, hedges, people-sized boxes.

use nalgebra::{Vector2, Vector3};

use super::face::Placement;
use super::street::Street;

/// Adds 40 to 70 objects for a street of usual length, in proportion for longer ones.
pub fn fill(street: &mut Street) {
    let [start, end] = street.span();
    let count = ((end - start) * street.draw.range(0.55, 0.95)) as usize;
    for _ in 0..count.max(40) {
        let arc = street.draw.range(start, end);
        let side = street.draw.sign();
        let [left, right] = street.edges();
        let edge = if side < 0.0 { -left } else { right };
        match street.draw.index(20) {
            0..=5 => parked_car(street, arc, side, edge),
            6..=8 => tree(street, arc, side, edge),
            9..=11 => post(street, arc, side, edge),
            12..=13 => hedge(street, arc, side, edge),
            _ => crate_or_person(street, arc, side, edge),
        }
    }
}

/// A car (or van) with its wheels at the local y = 0, along local z.
pub fn car_at(street: &mut Street, place: &Placement) {
    let skins = street.skins.clone();
    let (body, cabin) = (street.pick(&skins), street.pick(&skins));
    let shift = street.shift();
    let van = street.draw.chance(0.25);
    let (length, width) = (street.draw.range(1.8, 2.3), street.draw.range(0.8, 0.92));
    let waist = street.draw.range(0.7, 0.95);
    let mut part = |half: Vector3<f64>, y: f64, z: f64, materials| {
        let position = place.position + place.rotation * Vector3::new(0.0, y, z);
        let place = Placement { position, ..*place };
        street.scene.mesh.solid_box(&place, half, materials, shift, true);
    };
    part(Vector3::new(width, 0.5 * (waist - 0.2), length), -0.5 * (waist + 0.2), 0.0, [body, body]);
    let roof = if van { 0.55 } else { 0.3 };
    let cabin_length = length * if van { 0.9 } else { 0.52 };
    part(Vector3::new(0.92 * width, roof, cabin_length), -waist - roof, -0.1 * length, [cabin, body]);
    for (x, z) in [(-1.0, -0.62), (1.0, -0.62), (-1.0, 0.62), (1.0, 0.62)] {
        let wheel = Vector3::new(0.12, 0.3, 0.3);
        let position = place.position + place.rotation * Vector3::new(x * (width - 0.11), -0.3, z * length);
        let place = Placement { position, ..*place };
        let dark = street.skins[0];
        street.scene.mesh.solid_box(&place, wheel, [dark, dark], shift, true);
    }
}

fn parked_car(street: &mut Street, arc: f64, side: f64, edge: f64) {
    let lateral = edge - 0.35 + street.draw.range(-0.15, 0.5);
    let (ground, yaw) = street.at(arc, side * lateral);
    let yaw = yaw + street.draw.range(-0.05, 0.05);
    if street.is_free(ground, yaw, [0.95, 2.35]) {
        car_at(street, &Placement::upright(Vector3::new(ground.x, 0.0, ground.y), yaw));
    }
}

/// Where something stands on the pavement, if there is room for it.
fn on_pavement(street: &mut Street, arc: f64, side: f64, edge: f64, half: [f64; 2]) -> Option<(Vector2<f64>, f64)> {
    let lateral = edge + street.draw.range(0.2, street.pavement().max(0.4)) + 0.3 * half[0];
    let (ground, yaw) = street.at(arc, side * lateral);
    street.is_free(ground, yaw, half).then_some((ground, yaw))
}

fn tree(street: &mut Street, arc: f64, side: f64, edge: f64) {
    let crown = street.draw.range(0.7, 1.5);
    let Some((ground, yaw)) = on_pavement(street, arc, side, edge, [0.5, 0.5]) else {
        return;
    };
    let trunk = street.draw.range(1.9, 3.2);
    let place = Placement::upright(Vector3::new(ground.x, 0.0, ground.y), yaw);
    let (leaves, bark) = (street.leaves.clone(), street.skins[1]);
    let (leaf, shift) = (street.pick(&leaves), street.shift());
    street.scene.mesh.prism(&place, street.draw.range(0.12, 0.25), trunk + 0.3, 7, bark, shift);
    let top = Vector3::new(ground.x, -trunk - 0.8 * crown, ground.y);
    if street.draw.chance(0.65) {
        let half = Vector3::new(crown, crown * street.draw.range(0.8, 1.3), crown);
        street.scene.mesh.ball(&Placement::upright(top, yaw), half, 1, leaf, shift);
    } else {
        let base = Placement::upright(Vector3::new(ground.x, -0.6 * trunk, ground.y), yaw);
        street.scene.mesh.cone(&base, 0.9 * crown, trunk + 2.0 * crown, 8, leaf, shift);
    }
}

fn post(street: &mut Street, arc: f64, side: f64, edge: f64) {
    let radius = street.draw.range(0.09, 0.22);
    let Some((ground, yaw)) = on_pavement(street, arc, side, edge, [radius, radius]) else {
        return;
    };
    let height = street.draw.range(1.0, 6.0);
    let skins = street.skins.clone();
    let (skin, shift) = (street.pick(&skins), street.shift());
    let foot = Vector3::new(ground.x, 0.0, ground.y);
    street.scene.mesh.prism(&Placement::upright(foot, yaw), radius, height, 8, skin, shift);
    if height > 2.2 && street.draw.chance(0.5) {
        let sign = Vector3::new(street.draw.range(0.3, 0.6), street.draw.range(0.3, 0.6), 0.06);
        let (skin, turn) = (street.pick(&skins), yaw + street.draw.range(-0.4, 0.4));
        let place = Placement::upright(Vector3::new(ground.x, -height + 0.1, ground.y), turn);
        street.scene.mesh.solid_box(&place, sign, [skin, skin], shift, true);
    }
}

fn hedge(street: &mut Street, arc: f64, side: f64, edge: f64) {
    let half = Vector3::new(street.draw.range(0.25, 0.6), street.draw.range(0.3, 0.9), street.draw.range(1.0, 2.8));
    let Some((ground, yaw)) = on_pavement(street, arc, side, edge, [half.x, half.z]) else {
        return;
    };
    let leaves = street.leaves.clone();
    let (leaf, shift) = (street.pick(&leaves), street.shift());
    let place = Placement::upright(Vector3::new(ground.x, -half.y, ground.y), yaw);
    street.scene.mesh.solid_box(&place, half, [leaf, leaf], shift, false);
}

fn crate_or_person(street: &mut Street, arc: f64, side: f64, edge: f64) {
    let half = Vector3::new(street.draw.range(0.2, 1.1), street.draw.log_range(0.25, 1.9), street.draw.range(0.2, 1.1));
    let Some((ground, yaw)) = on_pavement(street, arc, side, edge, [half.x, half.z]) else {
        return;
    };
    let turn = yaw + street.draw.range(-0.6, 0.6);
    if !street.is_free(ground, turn, [half.x, half.z]) {
        return;
    }
    let skins = street.skins.clone();
    let (skin, top, shift) = (street.pick(&skins), street.pick(&skins), street.shift());
    let place = Placement::upright(Vector3::new(ground.x, -half.y, ground.y), turn);
    street.scene.mesh.solid_box(&place, half, [skin, top], shift, false);
}

// Joint transforms of a posed head and their derivatives. Twin of rig.rs, in single precision: the series for small angles
// goes further here, because the closed forms lose digits sooner.

// A turn about the origin and then a shift.
struct Rigid {
    turn: mat3x3f,
    offset: vec3f,
}

fn after(outer: Rigid, inner: Rigid) -> Rigid {
    return Rigid(outer.turn * inner.turn, outer.turn * inner.offset + outer.offset);
}

// The same where one of the two is a tangent, whose last row is 0 and not 0 0 0 1.
fn tangent_after(outer: Rigid, inner: Rigid) -> Rigid {
    return Rigid(outer.turn * inner.turn, outer.turn * inner.offset);
}

fn cross_matrix(v: vec3f) -> mat3x3f {
    return mat3x3f(vec3f(0.0, v.z, -v.y), vec3f(-v.z, 0.0, v.x), vec3f(v.y, -v.x, 0.0));
}

// Own text: what WGSL promises of sin and cos is too little for a pose.
fn sine_cosine(angle: f32) -> vec2f {
    let quadrant = round(angle * 0.63661977);
    let x = (angle - quadrant * 1.5703125) - quadrant * 4.8382673e-4;
    let s = x * x;
    let sine = x * (1.0 + s * (-0.16666667 + s * (8.3333333e-3 + s * (-1.984127e-4 + s * 2.7557319e-6))));
    let cosine = 1.0 + s * (-0.5 + s * (4.1666668e-2 + s * (-1.3888889e-3 + s * 2.4801587e-5)));
    let turns = i32(quadrant) & 3;
    let swapped = select(vec2f(sine, cosine), vec2f(cosine, -sine), (turns & 1) == 1);
    return select(swapped, -swapped, turns >= 2);
}

// sin θ/θ and (1 − cos θ)/θ², and their derivatives by θ².
fn rodrigues(s: f32) -> vec4f {
    if s < 1.0 {
        return vec4f(
            1.0 + s * (-0.16666667 + s * (8.3333333e-3 + s * (-1.984127e-4 + s * 2.7557319e-6))),
            0.5 + s * (-4.1666668e-2 + s * (1.3888889e-3 + s * (-2.4801587e-5 + s * 2.7557319e-7))),
            -0.16666667 + s * (1.6666667e-2 + s * (-5.952381e-4 + s * (1.1022928e-5 - s * 1.2526054e-7))),
            -4.1666668e-2 + s * (2.7777778e-3 + s * (-7.4404762e-5 + s * (1.1022928e-6 - s * 1.0438379e-8))),
        );
    }
    let angle = sqrt(s);
    let full = sine_cosine(angle);
    let half = sine_cosine(0.5 * angle).x;
    let one_minus = 2.0 * half * half;
    return vec4f(
        full.x / angle,
        one_minus / s,
        (angle * full.y - full.x) / (2.0 * s * angle),
        (angle * full.x - 2.0 * one_minus) / (2.0 * s * s),
    );
}

const IDENTITY = mat3x3f(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);

fn rotation(v: vec3f) -> mat3x3f {
    let c = rodrigues(dot(v, v));
    let k = cross_matrix(v);
    return IDENTITY + k * c.x + k * k * c.y;
}

// By one component of the vector.
fn rotation_derivative(v: vec3f, axis: u32) -> mat3x3f {
    let c = rodrigues(dot(v, v));
    var unit = vec3f(0.0);
    unit[axis] = 1.0;
    let k = cross_matrix(v);
    let e = cross_matrix(unit);
    let twice = 2.0 * dot(v, unit);
    return k * (c.z * twice) + k * k * (c.w * twice) + e * c.x + (e * k + k * e) * c.y;
}

fn turned(vector: vec3f, centre: vec3f) -> Rigid {
    let turn = rotation(vector);
    return Rigid(turn, centre - turn * centre);
}

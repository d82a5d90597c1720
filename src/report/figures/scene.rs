//! Camera and boards in space.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use super::super::drawing::{
    Anchor, BLUE, Color, Drawing, FITTED, INK, ORANGE, TYPE_COLORS, in_space, ticks,
};
use super::super::tree::Figure;
use crate::calibration::Calibration;
use crate::model::{Board, PlenopticCamera};

/// Viewing direction, rad: angle from the side towards the back of the camera, and angle from above.
const TURNED: f64 = 0.55;
const RAISED: f64 = 0.38;
/// Width of the picture, largest height of its content, and margin, px.
const WIDTH: f64 = 900.0;
const MOST_HEIGHT: f64 = 470.0;
const MARGIN: Vector2<f64> = Vector2::new(72.0, 44.0);
/// Margin above for the numbers of the frames, and width of one number, px.
const NUMBERS: f64 = 62.0;
const NUMBER: f64 = 27.0;
/// Number of segments of a circle.
const CIRCLE: u32 = 48;
const BOARD_COLORS: [Color; 6] =
    [BLUE, ORANGE, TYPE_COLORS[1], FITTED, TYPE_COLORS[0], TYPE_COLORS[2]];

/// A parallel projection onto the page, from mm to px.
struct View {
    right: Vector3<f64>,
    down: Vector3<f64>,
    into: Vector3<f64>,
    scale: f64,
    origin: Vector2<f64>,
}

impl View {
    /// Creates the view that shows all points, and the height of the picture, px. The scene has z to the right, x towards the
    /// reader and y down.
    fn of(points: &[Point3<f64>]) -> (Self, f64) {
        let (turned, raised) = (TURNED.sin_cos(), RAISED.sin_cos());
        let into = Vector3::new(-raised.1 * turned.1, raised.0, raised.1 * turned.0);
        let right = Vector3::new(turned.0, 0.0, turned.1);
        let mut view =
            Self { right, down: into.cross(&right), into, scale: 1.0, origin: Vector2::zeros() };
        let places: Vec<Vector2<f64>> = points.iter().map(|p| view.place(p)).collect();
        let low = places.iter().fold(Vector2::repeat(f64::INFINITY), |a, p| a.inf(p));
        let high = places.iter().fold(Vector2::repeat(f64::NEG_INFINITY), |a, p| a.sup(p));
        let size = (high - low).sup(&Vector2::repeat(1e-9));
        view.scale = ((WIDTH - 2.0 * MARGIN.x) / size.x).min(MOST_HEIGHT / size.y);
        let across = (WIDTH - view.scale * (low.x + high.x)) / 2.0;
        view.origin = Vector2::new(across, NUMBERS + MARGIN.y / 2.0 - view.scale * low.y);
        let height = NUMBERS + MARGIN.y * 1.4 + view.scale * size.y;
        (view, height)
    }

    fn place(&self, p: &Point3<f64>) -> Vector2<f64> {
        let flat = Vector2::new(self.right.dot(&p.coords), self.down.dot(&p.coords));
        self.origin + self.scale * flat
    }

    fn places(&self, points: &[Point3<f64>]) -> Vec<Vector2<f64>> {
        points.iter().map(|p| self.place(p)).collect()
    }

    /// Draws a line.
    fn line(&self, points: &[Point3<f64>], color: Color, width: f64, drawing: &mut Drawing) {
        drawing.next_in_space(points);
        drawing.line(&self.places(points), color, width);
    }

    /// Draws a surface with its outline.
    fn surface(&self, outline: &[Point3<f64>], color: Color, opacity: f64, drawing: &mut Drawing) {
        drawing.next_in_space(outline);
        drawing.area(&self.places(outline), color, opacity);
        let around: Vec<_> = outline.iter().chain(outline.first()).copied().collect();
        self.line(&around, color, 1.4, drawing);
    }
}

pub(super) fn scene(calibration: &Calibration, board: &Board) -> Option<Figure> {
    let camera = &calibration.camera;
    let finite = |pose: &Isometry3<f64>| pose.to_homogeneous().iter().all(|v| v.is_finite());
    let boards: Vec<(u32, [Point3<f64>; 4])> = calibration
        .poses
        .iter()
        .filter(|p| finite(&p.camera_from_board))
        .map(|p| (p.frame, outline(board, &p.camera_from_board)))
        .collect();
    let furthest = boards.iter().flat_map(|(_, b)| b).map(|p| p.z).reduce(f64::max)?;

    let (sensor, lens) = (sensor_outline(camera), lens_outline(camera));
    let mut points: Vec<Point3<f64>> = boards.iter().flat_map(|(_, b)| *b).collect();
    points.extend(sensor.iter().chain(&lens));
    let bounds = Box3::around(&points);
    points.extend(bounds.corners());
    let (view, height) = View::of(&points);
    let mut drawing = Drawing::new(WIDTH, height.ceil());
    let ends = [Point3::from(bounds.low), Point3::from(bounds.high)];
    drawing.set_data("scene", &format!("{TURNED},{RAISED} {}", in_space(&ends)));
    bounds.draw(&view, &mut drawing);
    field_of_view(&sensor, furthest, &view, &mut drawing);
    // Distant boards are drawn first.
    let mut order: Vec<usize> = (0..boards.len()).collect();
    let depth = |i: usize| boards[i].1.iter().map(|p| view.into.dot(&p.coords)).sum::<f64>();
    order.sort_by(|&a, &b| depth(b).total_cmp(&depth(a)));
    for i in order {
        let color = BOARD_COLORS[i % BOARD_COLORS.len()];
        let corners = &boards[i].1;
        view.surface(corners, color, 0.1, &mut drawing);
        drawing.next_in_space(&corners[..1]);
        drawing.discs(&view.places(&corners[..1]), 2.6, color);
    }
    draw_camera(&sensor, &lens, &view, &mut drawing);
    numbers(&boards, &view, &mut drawing);
    let caption = "Camera and boards in the camera frame, mm. Numbers are frames; a dot marks the \
                   first corner of a board; dashed lines bound the field of view."
        .to_owned();
    Some(drawing.figure("scene", caption))
}

/// Returns the outline of a board: its inner corners and one square around them, from the first corner.
fn outline(board: &Board, camera_from_board: &Isometry3<f64>) -> [Point3<f64>; 4] {
    let (right, below) = (f64::from(board.columns), f64::from(board.rows));
    [(-1.0, -1.0), (right, -1.0), (right, below), (-1.0, below)].map(|(column, row)| {
        camera_from_board * Point3::new(column * board.square_mm, row * board.square_mm, 0.0)
    })
}

fn sensor_outline(camera: &PlenopticCamera) -> [Point3<f64>; 4] {
    let (width, height) = (f64::from(camera.sensor.width_px), f64::from(camera.sensor.height_px));
    let z = -(camera.mla.lens_to_mla_mm + camera.mla.mla_to_sensor_mm);
    [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)].map(|(u, v)| {
        let from_axis = camera.mla.principal_point_px - Vector2::new(u - 0.5, v - 0.5);
        let place = from_axis * camera.sensor.pixel_size_mm;
        Point3::new(place.x, place.y, z)
    })
}

/// Returns the outline of the main lens with its f-number, or f/2.8 if it is not known.
fn lens_outline(camera: &PlenopticCamera) -> Vec<Point3<f64>> {
    let lens = &camera.main_lens;
    let f_number = lens.setting.map_or(2.8, |setting| setting.f_number);
    let radius = lens.focal_length_mm / (2.0 * f_number);
    (0..CIRCLE)
        .map(|i| (std::f64::consts::TAU * f64::from(i) / f64::from(CIRCLE)).sin_cos())
        .map(|(sin, cos)| Point3::new(radius * cos, radius * sin, 0.0))
        .collect()
}

fn draw_camera(sensor: &[Point3<f64>], lens: &[Point3<f64>], view: &View, drawing: &mut Drawing) {
    for outline in [sensor, lens] {
        view.surface(outline, INK, 0.25, drawing);
    }
    let above = |outline: &[Point3<f64>]| {
        let places = view.places(outline);
        let top = places.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
        let middle = places.iter().map(|p| p.x).sum::<f64>() / places.len() as f64;
        Vector2::new(middle, top)
    };
    let ends = [&sensor[..1], &lens[..1]];
    let (sensor, lens) = (above(sensor), above(lens));
    // The words are side by side if there is room, else one above the other.
    let apart = (lens.x - sensor.x).abs() > 90.0;
    let line = sensor.y.min(lens.y) - 14.0;
    let sensor_word = Vector2::new(sensor.x, if apart { sensor.y - 14.0 } else { line });
    let lens_word = Vector2::new(lens.x, if apart { lens.y - 14.0 } else { line - 18.0 });
    drawing.next_in_space(ends[0]);
    drawing.text(sensor_word, Anchor::Middle, 13.0, "sensor");
    drawing.next_in_space(ends[1]);
    drawing.text(lens_word, Anchor::Middle, 13.0, "main lens");
}

fn field_of_view(sensor: &[Point3<f64>], furthest: f64, view: &View, drawing: &mut Drawing) {
    for corner in sensor {
        let end = Point3::from(corner.coords * (furthest / corner.z));
        drawing.next_in_space(&[*corner, end]);
        drawing.dashed(&view.places(&[*corner, end]), INK, 0.6);
    }
}

/// Draws the numbers of the frames in a row at the top, so that none hides another, each joined to its board by a line.
fn numbers(boards: &[(u32, [Point3<f64>; 4])], view: &View, drawing: &mut Drawing) {
    let mut tops: Vec<(usize, Vector2<f64>)> = boards
        .iter()
        .enumerate()
        .filter_map(|(i, (_, outline))| {
            let places = view.places(outline);
            let top = places.into_iter().min_by(|a, b| a.y.total_cmp(&b.y))?;
            Some((i, top))
        })
        .collect();
    tops.sort_by(|a, b| a.1.x.total_cmp(&b.1.x));
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small number
    let most = ((WIDTH - 2.0 * NUMBER) / NUMBER) as usize;
    let every = tops.len().div_ceil(most).max(1);
    let shown: Vec<_> = tops.into_iter().step_by(every).collect();
    // The distances are at least a number's width from the left, then from the right.
    let mut places: Vec<f64> = Vec::new();
    for (_, top) in &shown {
        places.push(places.last().map_or(NUMBER, |last| last + NUMBER).max(top.x));
    }
    let mut limit = WIDTH - NUMBER;
    for place in places.iter_mut().rev() {
        *place = place.min(limit);
        limit = *place - NUMBER;
    }
    for ((i, top), x) in shown.into_iter().zip(places) {
        let color = BOARD_COLORS[i % BOARD_COLORS.len()];
        let number = Vector2::new(x, 20.0);
        drawing.next_in_space(&boards[i].1);
        drawing.next_from_number();
        drawing.line(&[number + Vector2::new(0.0, 9.0), top], color, 0.6);
        drawing.colored_text(number, Anchor::Middle, 13.0, color, &boards[i].0.to_string());
    }
}

/// The box around the scene.
struct Box3 {
    low: Vector3<f64>,
    high: Vector3<f64>,
}

impl Box3 {
    fn around(points: &[Point3<f64>]) -> Self {
        let low = points.iter().fold(Vector3::repeat(f64::INFINITY), |a, p| a.inf(&p.coords));
        let high = points.iter().fold(Vector3::repeat(f64::NEG_INFINITY), |a, p| a.sup(&p.coords));
        let margin = (high - low) * 0.04;
        Self { low: low - margin, high: high + margin }
    }

    fn corners(&self) -> impl Iterator<Item = Point3<f64>> {
        let ends = [self.low, self.high];
        (0..8).map(move |i| Point3::new(ends[i & 1].x, ends[(i >> 1) & 1].y, ends[(i >> 2) & 1].z))
    }

    /// Draws the floor and the rear wall with their ticks.
    fn draw(&self, view: &View, drawing: &mut Drawing) {
        let (low, high, apart) = (self.low, self.high, TICK / view.scale);
        let floor = |x: f64, z: f64| Point3::new(x, high.y, z);
        let wall = |y: f64, z: f64| Point3::new(low.x, y, z);
        let mut line = |from: Point3<f64>, to: Point3<f64>, width: f64| {
            view.line(&[from, to], INK, width, drawing);
        };
        for (z, _) in ticks(low.z, high.z, apart) {
            line(floor(low.x, z), floor(high.x, z), 0.25);
            line(wall(low.y, z), wall(high.y, z), 0.25);
        }
        for (x, _) in ticks(low.x, high.x, apart) {
            line(floor(x, low.z), floor(x, high.z), 0.25);
        }
        for (y, _) in ticks(low.y, high.y, apart) {
            line(wall(y, low.z), wall(y, high.z), 0.25);
        }
        line(floor(high.x, low.z), floor(high.x, high.z), 0.9);
        line(floor(low.x, low.z), floor(high.x, low.z), 0.9);
        line(wall(low.y, low.z), wall(high.y, low.z), 0.9);

        let mut words = |at: Point3<f64>, shift: Vector2<f64>, anchor: Anchor, words: &str| {
            drawing.next_in_space(&[at]);
            drawing.text(view.place(&at) + shift, anchor, 12.0, words);
        };
        let below = Vector2::new(4.0, 12.0);
        for (z, name) in ticks(low.z, high.z, apart) {
            words(floor(high.x, z), below, Anchor::Middle, &name);
        }
        for (x, name) in ticks(low.x, high.x, apart) {
            words(floor(x, low.z), Vector2::new(-6.0, 8.0), Anchor::End, &name);
        }
        for (y, name) in ticks(low.y, high.y, apart) {
            words(wall(y, low.z), Vector2::new(-7.0, 0.0), Anchor::End, &name);
        }
        let middle = f64::midpoint(low.z, high.z);
        words(floor(high.x, middle), Vector2::new(16.0, 30.0), Anchor::Middle, "z, mm");
        let middle = f64::midpoint(low.x, high.x);
        words(floor(middle, low.z), Vector2::new(-40.0, 14.0), Anchor::End, "x, mm");
        words(wall(low.y, low.z), Vector2::new(-7.0, -16.0), Anchor::Middle, "y, mm");
    }
}

/// Smallest distance between ticks, px.
const TICK: f64 = 32.0;

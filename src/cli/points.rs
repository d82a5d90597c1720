//! `plenocal points`: computes metric points from virtual depths.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use nalgebra::Vector2;
use plenocal::assessment::{DistanceCheck, check_corners, check_places, check_virtual_points};
use plenocal::io::{
    self, DepthMap, ImageReader, OutputFolder, PlyColumn, PlyWriter, VirtualDepths,
};
use plenocal::model::PlenopticCamera;
use plenocal::solver::{
    MetricPoint, MicroPixel, VirtualPoint, corners, focused_points, metric_points, micro_images_at,
};
use plenocal::{Error, Finding, Issue, Result, Severity};
use serde_json::{Value, json};

use super::evaluate::{calibrated, distance_check};
use super::messages::{announce_memory, print_result, tell};

/// Compute metric points from virtual depths with a calibrated camera.
///
/// Virtual depths come from other software (RxLive, PlenopticToolbox) or your own. A virtual depth is the distance of the image
/// formed by the main lens, behind the array, in units of the distance between array and sensor. Points are in the camera
/// frame: the origin is the middle of the main lens, x points to the right, y down and z towards the scene.
// Names in the help are not code.
#[allow(clippy::doc_markdown)]
#[derive(Args)]
#[command(after_help = EXAMPLES, allow_negative_numbers = true)]
pub struct Arguments {
    /// Calibrated camera (camera.json, COMPOTE's intrinsics.js).
    camera: PathBuf,
    /// Virtual depths: CSV k,l,u,v,nu; a map of them as .npy (height x width) or as an image; or features.csv, whose corners
    /// are triangulated.
    input: PathBuf,
    #[arg(long, value_name = "DIR", help = results_help!("points.ply, and with --csv points.csv"))]
    out: PathBuf,
    /// Kind of the pixels of a map.
    #[arg(long, default_value = "raw")]
    map: MapKind,
    /// Scale of the grey levels of an image: the virtual depth is A + B times the level. Level 0 has no depth.
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    depth_scale: Option<Vec<f64>>,
    /// Standard deviation of u and v, px, if the file states none.
    #[arg(long, value_name = "PX", default_value_t = 0.0)]
    uv_std_dev: f64,
    /// Standard deviation of virtual depths, if the file states none.
    #[arg(long, value_name = "NU", default_value_t = 0.0)]
    depth_std_dev: f64,
    /// Also write the points as CSV.
    #[arg(long)]
    csv: bool,
    /// Print a summary as one JSON object instead of sentences.
    #[arg(long)]
    json: bool,
}

/// Kind of the pixels of a map of virtual depths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum MapKind {
    /// Pixels of the raw image.
    Raw,
    /// Pixels of a total-focus image of any size, at the positions of the virtual images across the axis.
    Focused,
}

const EXAMPLES: &str = "\
Examples:
  plenocal points camera.json virtual-depths.csv --csv --out points
  plenocal points camera.json depths.npy --depth-std-dev 0.02 --out points
  plenocal points camera.json depths.tiff --map focused --depth-scale 0,0.001 --out points
  plenocal points camera.json boards/features.csv --out corners";

/// Number of pixels of a map whose points are in memory at once.
const AT_ONCE: usize = 1 << 16;

/// Columns of points.csv with standard deviations and covariances.
const SPREAD_COLUMNS: &str = ",sigma_x_mm,sigma_y_mm,sigma_z_mm,cov_xy_mm2,cov_xz_mm2,cov_yz_mm2";

/// Number of copies of an image in memory: the file and the samples.
const IMAGE_COPIES: f64 = 2.0;
/// Memory of a row of a CSV file, bytes: 450 were measured with a million rows.
const ROW_BYTES: f64 = 450.0;

/// Points with the names of their labels, piece by piece.
struct Cloud<'a> {
    pieces: Pieces<'a>,
    names: [&'static str; 2],
    /// True if the σ of points are known.
    has_std_devs: bool,
    findings: Vec<Finding>,
}

type Pieces<'a> = Box<dyn Iterator<Item = Result<Piece>> + 'a>;

/// Part of the points, with their labels.
struct Piece {
    points: Vec<Option<MetricPoint>>,
    labels: [Vec<i32>; 2],
}

impl Piece {
    /// Returns the pieces of a cloud that has only this one.
    fn alone(self) -> Pieces<'static> {
        Box::new(std::iter::once(Ok(self)))
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let mut output = OutputFolder::new(&arguments.out)?;
    let camera = calibrated(&arguments.camera)?;
    let mut cloud = cloud(arguments, &camera).map_err(|e| e.in_file(&arguments.input))?;
    let mut summary = Summary::new(distance_check(&arguments.camera)?);
    stage(&mut output, &mut cloud, arguments.csv, &mut summary)
        .map_err(|e| e.in_file(&arguments.input))?;
    if summary.points == 0 {
        return Err(Error::invalid(no_point(&cloud.findings)).in_file(&arguments.input));
    }
    cloud.findings.extend(summary.distances.and_then(|check| check.finding()));
    let document = document(arguments, &cloud, summary);
    let paths = output.commit()?;
    tell(&cloud.findings);
    print_result(arguments.json, &document, &text(&document), &paths)?;
    Ok(ExitCode::SUCCESS)
}

/// Writes all points, and summarises them.
fn stage(
    output: &mut OutputFolder,
    cloud: &mut Cloud,
    with_csv: bool,
    summary: &mut Summary,
) -> Result<()> {
    let (names, has_std_devs) = (cloud.names, cloud.has_std_devs);
    let mut ply = PlyWriter::new(output.begin("points.ply")?, "plenocal points, mm, camera frame");
    let mut csv = if with_csv { Some(output.begin("points.csv")?) } else { None };
    if let Some(file) = &mut csv {
        let [first, second] = names;
        let std_devs = if has_std_devs { SPREAD_COLUMNS } else { "" };
        writeln!(file, "{first},{second},x_mm,y_mm,z_mm{std_devs}").map_err(|e| file.error(e))?;
    }
    for piece in &mut cloud.pieces {
        let piece = piece?;
        piece.points.iter().for_each(|point| summary.add(point.as_ref()));
        let columns = columns(&piece, names, has_std_devs);
        ply.write(&columns).map_err(|e| ply.get_ref().error(e))?;
        if let Some(file) = &mut csv {
            write_csv(file, &piece, has_std_devs).map_err(|e| file.error(e))?;
        }
    }
    output.finish(ply.finish().map_err(|(file, e)| file.error(e))?)?;
    csv.map_or(Ok(()), |csv| output.finish(csv))
}

fn cloud<'a>(arguments: &'a Arguments, camera: &'a PlenopticCamera) -> Result<Cloud<'a>> {
    let std_dev = [arguments.uv_std_dev, arguments.uv_std_dev, arguments.depth_std_dev];
    let scale = match arguments.depth_scale.as_deref() {
        None => None,
        Some(&[offset, factor]) => Some([offset, factor]),
        Some(_) => return Err(Error::invalid("--depth-scale takes two numbers, A,B")),
    };
    // A pipe can be read only once, and has no size.
    if arguments.input.is_file()
        && let Ok(bytes) = ImageReader::default().bytes(&arguments.input)
    {
        announce_memory("reading an image of this size", bytes as f64 * IMAGE_COPIES);
    }
    match io::read_virtual_depths(&arguments.input, scale, std_dev)? {
        VirtualDepths::Points(seen) => {
            let labels =
                [seen.iter().map(|s| s.at.k).collect(), seen.iter().map(|s| s.at.l).collect()];
            announce_points(seen.len());
            let mut findings = check_virtual_points(camera, &seen)?;
            // σ of the virtual depth dominates the σ of the point.
            let has_std_devs = seen.iter().all(|point| point.std_dev[2] > 0.0);
            findings.extend(without_std_devs(has_std_devs));
            let pieces = Piece { points: metric_points(camera, &seen)?, labels }.alone();
            Ok(Cloud { pieces, names: ["k", "l"], has_std_devs, findings })
        }
        VirtualDepths::Map(map) => of_map(map, arguments.map, std_dev, camera),
        VirtualDepths::Features => of_features(&arguments.input, camera),
    }
}

/// Announces the memory for the points of a CSV file.
fn announce_points(rows: usize) {
    announce_memory(&format!("computing with {rows} rows"), rows as f64 * ROW_BYTES);
}

/// Triangulates corners of boards, each from all its features in a frame.
fn of_features(path: &Path, camera: &PlenopticCamera) -> Result<Cloud<'static>> {
    let features = io::read_features(path, false)?.features;
    announce_points(features.len());
    let found = corners(camera, &features)?;
    let at = features.iter().map(|f| MicroPixel { k: f.k, l: f.l, u_px: f.u_px, v_px: f.v_px });
    let mut findings = check_places(camera, at)?;
    findings.extend(check_corners(&found, &features));
    let frames = found.labels.iter().map(|(frame, _)| i32::try_from(*frame).unwrap_or(i32::MAX));
    let numbers = found.labels.iter().map(|(_, corner)| *corner);
    let labels = [frames.collect(), numbers.collect()];
    let pieces = Piece { points: found.points, labels }.alone();
    Ok(Cloud { pieces, names: ["frame", "corner"], has_std_devs: true, findings })
}

fn of_map(
    mut map: DepthMap,
    kind: MapKind,
    std_dev: [f64; 3],
    camera: &PlenopticCamera,
) -> Result<Cloud<'_>> {
    let sensor = &camera.sensor;
    let (width, height) = (f64::from(sensor.width_px), f64::from(sensor.height_px));
    let scale = Vector2::new(width / map.width as f64, height / map.height as f64);
    if kind == MapKind::Raw && scale != Vector2::new(1.0, 1.0) {
        return Err(Error::invalid(format!(
            "the map has {} x {} px, but the raw image of this camera has {width} x {height} px: \
             give --map focused if it is of a total-focus image",
            map.width, map.height
        )));
    }
    let mut first = 0;
    let next = move || -> Result<Option<Piece>> {
        let depths = map.next(AT_ONCE)?;
        if depths.is_empty() {
            return Ok(None);
        }
        let with_depth = (first..).zip(&depths).filter(|(_, depth)| depth.is_finite());
        let place = |i: usize| {
            // (0, 0) is the centre of the first pixel, in the map as in the raw image.
            let pixel = Vector2::new((i % map.width) as f64 + 0.5, (i / map.width) as f64 + 0.5);
            pixel.component_mul(&scale) - Vector2::new(0.5, 0.5)
        };
        let seen: Vec<(Vector2<f64>, f64)> =
            with_depth.map(|(i, depth)| (place(i), *depth)).collect();
        first += depths.len();
        piece_of_map(&seen, kind, std_dev, camera).map(Some)
    };
    let mut next = Some(next);
    // The map must not be read on after an error.
    let pieces = std::iter::from_fn(move || {
        let found = next.as_mut()?().transpose();
        if !matches!(found, Some(Ok(_))) {
            next = None;
        }
        found
    });
    let has_std_devs = std_dev[2] > 0.0;
    let findings = without_std_devs(has_std_devs).into_iter().collect();
    Ok(Cloud { pieces: Box::new(pieces), names: ["u", "v"], has_std_devs, findings })
}

/// Computes the points of pixels that have a virtual depth.
fn piece_of_map(
    pixels: &[(Vector2<f64>, f64)],
    kind: MapKind,
    std_dev: [f64; 3],
    camera: &PlenopticCamera,
) -> Result<Piece> {
    let places: Vec<Vector2<f64>> = pixels.iter().map(|(place, _)| *place).collect();
    let at = match kind {
        MapKind::Raw => micro_images_at(camera, &places)?,
        MapKind::Focused => vec![None; places.len()],
    };
    let seen: Vec<VirtualPoint> = pixels
        .iter()
        .zip(at)
        .map(|(&(place, virtual_depth), at)| {
            let (k, l) = at.unwrap_or((-1, -1));
            VirtualPoint {
                at: MicroPixel { k, l, u_px: place.x, v_px: place.y },
                virtual_depth,
                std_dev,
            }
        })
        .collect();
    let points = match kind {
        MapKind::Raw => metric_points(camera, &seen)?,
        MapKind::Focused => focused_points(camera, &seen)?,
    };
    #[allow(clippy::cast_possible_truncation)] // within an image
    let whole =
        |of: fn(&Vector2<f64>) -> f64| places.iter().map(|p| of(p).round() as i32).collect();
    Ok(Piece { points, labels: [whole(|p| p.x), whole(|p| p.y)] })
}

/// Returns a note if no σ of points is known.
fn without_std_devs(known: bool) -> Option<Finding> {
    (!known).then(|| Finding::note(Issue::PointsWithoutSigma))
}

/// Explains why no virtual depth gives a point.
fn no_point(findings: &[Finding]) -> String {
    let told: Vec<String> = findings
        .iter()
        .filter(|finding| finding.severity > Severity::Note)
        .map(ToString::to_string)
        .collect();
    if told.is_empty() {
        "no point: check that the virtual depths are of this camera, measured from the array and \
         positive behind it; the main lens forms images only beyond its focal length"
            .to_owned()
    } else {
        format!("no point:\n  {}", told.join("\n  "))
    }
}

fn columns(piece: &Piece, names: [&'static str; 2], has_std_devs: bool) -> Vec<PlyColumn<'static>> {
    let points = || piece.points.iter().flatten();
    let coordinate = |axis: usize| points().map(|p| p.point_mm[axis]).collect();
    let std_dev = |axis: usize| points().map(|p| p.std_devs_mm()[axis]).collect();
    let mut columns = vec![
        PlyColumn::Float("x", coordinate(0)),
        PlyColumn::Float("y", coordinate(1)),
        PlyColumn::Float("z", coordinate(2)),
    ];
    if has_std_devs {
        let names = ["sigma_x", "sigma_y", "sigma_z"];
        columns.extend((0..).zip(names).map(|(axis, name)| PlyColumn::Float(name, std_dev(axis))));
    }
    for (name, labels) in names.into_iter().zip(&piece.labels) {
        let kept = labels.iter().zip(&piece.points).filter(|(_, point)| point.is_some());
        columns.push(PlyColumn::Int(name, kept.map(|(label, _)| *label).collect()));
    }
    columns
}

fn write_csv(out: &mut dyn Write, piece: &Piece, has_std_devs: bool) -> std::io::Result<()> {
    let [firsts, seconds] = &piece.labels;
    for ((point, a), b) in piece.points.iter().zip(firsts).zip(seconds) {
        let Some(point) = point else { continue };
        let ([x, y, z], [sx, sy, sz]) = (point.point_mm, point.std_devs_mm());
        let [_, xy, xz, _, _, yz, ..] = point.covariance_mm2;
        write!(out, "{a},{b},{x:.6},{y:.6},{z:.6}")?;
        if has_std_devs {
            write!(out, ",{sx:.6},{sy:.6},{sz:.6},{xy:.3e},{xz:.3e},{yz:.3e}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

/// Summary of all points.
struct Summary {
    points: u64,
    without_point: u64,
    distances_mm: Sample,
    std_devs_mm: [Sample; 3],
    distances: Option<DistanceCheck>,
}

impl Summary {
    fn new(distances: Option<DistanceCheck>) -> Self {
        Self {
            points: 0,
            without_point: 0,
            distances_mm: Sample::default(),
            std_devs_mm: Default::default(),
            distances,
        }
    }

    fn add(&mut self, point: Option<&MetricPoint>) {
        let Some(point) = point else {
            self.without_point += 1;
            return;
        };
        self.points += 1;
        let z_mm = point.point_mm[2];
        self.distances_mm.add(z_mm);
        for (sample, std_dev) in self.std_devs_mm.iter_mut().zip(point.std_devs_mm()) {
            sample.add(std_dev);
        }
        if let Some(check) = &mut self.distances {
            check.count(z_mm);
        }
    }
}

/// Values for quantiles: all of them or, if there are many, every `every`-th.
struct Sample {
    values: Vec<f64>,
    every: usize,
    count: usize,
}

/// Largest number of values: it gives the median to a thousandth of their spread.
const MOST_VALUES: usize = 1 << 20;

impl Default for Sample {
    fn default() -> Self {
        Self { values: Vec::new(), every: 1, count: 0 }
    }
}

impl Sample {
    fn add(&mut self, value: f64) {
        if self.count.is_multiple_of(self.every) {
            if self.values.len() == MOST_VALUES {
                self.every *= 2;
                let mut index = 0_usize;
                self.values.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
            }
            if self.count.is_multiple_of(self.every) {
                self.values.push(value);
            }
        }
        self.count += 1;
    }

    /// Returns the quantile at a fraction `part` of the values; NaN if there are none.
    fn quantile(&mut self, part: f64) -> f64 {
        self.values.sort_by(f64::total_cmp);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within the values
        let index = (part * self.values.len().saturating_sub(1) as f64).round() as usize;
        self.values.get(index).copied().unwrap_or(f64::NAN)
    }
}

fn document(arguments: &Arguments, cloud: &Cloud, mut summary: Summary) -> Value {
    let [near, median, far] = [0.05, 0.5, 0.95].map(|part| summary.distances_mm.quantile(part));
    let known = cloud.has_std_devs;
    let [x, y, z] = summary.std_devs_mm.map(|mut sample| known.then(|| sample.quantile(0.5)));
    json!({
        "input": arguments.input.display().to_string(),
        "camera": arguments.camera.display().to_string(),
        "points": summary.points,
        "without_point": summary.without_point,
        "distance_mm": { "near": near, "median": median, "far": far },
        "findings": cloud.findings,
        "median_sigma_mm": { "x": x, "y": y, "z": z },
    })
}

fn text(document: &Value) -> String {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let (distance, sigma) = (&document["distance_mm"], &document["median_sigma_mm"]);
    let mut lines = vec![format!(
        "{} points, 9 of 10 between {:.1} and {:.1} mm from the main lens, half of them nearer than {:.1} mm.",
        document["points"],
        number(&distance["near"]),
        number(&distance["far"]),
        number(&distance["median"]),
    )];
    if document["without_point"] != 0 {
        lines.push(format!(
            "{} without a point: outside the array, without an image at that depth, or seen only once.",
            document["without_point"]
        ));
    }
    if number(&sigma["z"]) > 0.0 {
        lines.push(format!(
            "σ from the measurement is {:.3} mm across the axis and {:.3} mm along it (median); σ \
             from the camera adds to it.",
            number(&sigma["x"]).hypot(number(&sigma["y"])) / std::f64::consts::SQRT_2,
            number(&sigma["z"]),
        ));
    }
    lines.join("\n")
}

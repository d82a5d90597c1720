//! `plenocal points`: metric points from virtual depths.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use nalgebra::Vector2;
use plenocal::assessment::{check_corners, check_places, check_virtual_points};
use plenocal::io::{self, DepthMap, OutputFolder, PlyColumn, VirtualDepths};
use plenocal::model::PlenopticCamera;
use plenocal::solver::{
    MetricPoint, MicroPixel, VirtualPoint, corners, focused_points, metric_points, micro_images_at,
};
use plenocal::{Error, Finding, Issue, Result, Severity};
use serde_json::{Value, json};

use super::evaluate::{beyond_boards, calibrated};
use super::messages::{print_result, tell};

/// Make metric points of virtual depths, by a calibrated camera.
///
/// Virtual depths are those of other software (RxLive, PlenopticToolbox) or your own: the distance of the image that the main
/// lens makes, behind the array, in units of the distance between array and sensor. Points are in the camera frame: the
/// origin is the middle of the main lens, x points to the right, y down and z towards the scene.
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
    /// How the pixels of a map lie.
    #[arg(long, default_value = "raw")]
    map: MapKind,
    /// What the grey levels of an image mean: the virtual depth is A + B times the level. Level 0 has no depth.
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    depth_scale: Option<Vec<f64>>,
    /// Standard deviation of u and v, px, where the file states none.
    #[arg(long, value_name = "PX", default_value_t = 0.0)]
    uv_std_dev: f64,
    /// Standard deviation of virtual depths where the file states none.
    #[arg(long, value_name = "NU", default_value_t = 0.0)]
    depth_std_dev: f64,
    /// Also write the points as CSV.
    #[arg(long)]
    csv: bool,
    /// Print what was done as one JSON object instead of sentences.
    #[arg(long)]
    json: bool,
}

/// How the pixels of a map of virtual depths lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum MapKind {
    /// As those of the raw image.
    Raw,
    /// As those of a total-focus image, of any size: straight before the images of points.
    Focused,
}

const EXAMPLES: &str = "\
Examples:
  plenocal points camera.json virtual-depths.csv --csv --out points
  plenocal points camera.json depths.npy --depth-std-dev 0.02 --out points
  plenocal points camera.json depths.tiff --map focused --depth-scale 0,0.001 --out points
  plenocal points camera.json boards/features.csv --out corners";

/// Points with what they are called in the files.
struct Cloud {
    points: Vec<Option<MetricPoint>>,
    labels: [(&'static str, Vec<i32>); 2],
    /// Whether the σ of points are known.
    has_std_devs: bool,
    findings: Vec<Finding>,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let mut output = OutputFolder::new(&arguments.out)?;
    let camera = calibrated(&arguments.camera)?;
    let mut cloud = cloud(arguments, &camera).map_err(|e| e.in_file(&arguments.input))?;
    let found = cloud.points.iter().flatten().count();
    if found == 0 {
        return Err(Error::invalid(no_point(&cloud.findings)).in_file(&arguments.input));
    }
    output.stage("points.ply", |out| {
        io::write_ply(out, "plenocal points, mm, camera frame", &columns(&cloud))
    })?;
    if arguments.csv {
        output.stage("points.csv", |out| write_csv(out, &cloud))?;
    }
    let depths: Vec<f64> = cloud.points.iter().flatten().map(|p| p.point_mm[2]).collect();
    cloud.findings.extend(beyond_boards(&arguments.camera, &depths)?);
    let document = document(arguments, &cloud);
    let paths = output.commit()?;
    tell(&cloud.findings);
    print_result(arguments.json, &document, &text(&document), &paths)?;
    Ok(ExitCode::SUCCESS)
}

fn cloud(arguments: &Arguments, camera: &PlenopticCamera) -> Result<Cloud> {
    let std_dev = [arguments.uv_std_dev, arguments.uv_std_dev, arguments.depth_std_dev];
    let scale = match arguments.depth_scale.as_deref() {
        None => None,
        Some(&[offset, factor]) => Some([offset, factor]),
        Some(_) => return Err(Error::invalid("--depth-scale takes two numbers, A,B")),
    };
    match io::read_virtual_depths(&arguments.input, scale, std_dev)? {
        VirtualDepths::Points(seen) => {
            let labels = [
                ("k", seen.iter().map(|s| s.at.k).collect()),
                ("l", seen.iter().map(|s| s.at.l).collect()),
            ];
            let mut findings = check_virtual_points(camera, &seen)?;
            // The depth decides on the distance of a point.
            let has_std_devs = seen.iter().all(|point| point.std_dev[2] > 0.0);
            findings.extend(without_std_devs(has_std_devs));
            Ok(Cloud { points: metric_points(camera, &seen)?, labels, has_std_devs, findings })
        }
        VirtualDepths::Map(map) => of_map(&map, arguments.map, std_dev, camera),
        VirtualDepths::Features => of_features(&arguments.input, camera),
    }
}

/// Corners of boards, each by all its features in a frame.
fn of_features(path: &Path, camera: &PlenopticCamera) -> Result<Cloud> {
    let features = io::read_features(path, false)?.features;
    let found = corners(camera, &features)?;
    let at = features.iter().map(|f| MicroPixel { k: f.k, l: f.l, u_px: f.u_px, v_px: f.v_px });
    let mut findings = check_places(camera, at)?;
    findings.extend(check_corners(&found, &features));
    let frames = found.labels.iter().map(|(frame, _)| i32::try_from(*frame).unwrap_or(i32::MAX));
    let numbers = found.labels.iter().map(|(_, corner)| *corner);
    let labels = [("frame", frames.collect()), ("corner", numbers.collect())];
    Ok(Cloud { points: found.points, labels, has_std_devs: true, findings })
}

fn of_map(
    map: &DepthMap,
    kind: MapKind,
    std_dev: [f64; 3],
    camera: &PlenopticCamera,
) -> Result<Cloud> {
    let sensor = &camera.sensor;
    let (width, height) = (f64::from(sensor.width_px), f64::from(sensor.height_px));
    let scale = Vector2::new(width / map.width as f64, height / map.height as f64);
    if kind == MapKind::Raw && scale != Vector2::new(1.0, 1.0) {
        return Err(Error::invalid(format!(
            "the map has {} x {} px, but the raw image of this camera {width} x {height}: is it that of a total-focus image \
             (--map focused)?",
            map.width, map.height
        )));
    }
    let mut places = Vec::new();
    let mut depths = Vec::new();
    for (i, depth) in map.depths.iter().enumerate().filter(|(_, depth)| depth.is_finite()) {
        // Pixel (0, 0) is the middle of the first one, in the map as in the raw image.
        let pixel = Vector2::new((i % map.width) as f64 + 0.5, (i / map.width) as f64 + 0.5);
        places.push(pixel.component_mul(&scale) - Vector2::new(0.5, 0.5));
        depths.push(*depth);
    }
    let at = match kind {
        MapKind::Raw => micro_images_at(camera, &places)?,
        MapKind::Focused => vec![None; places.len()],
    };
    let seen: Vec<VirtualPoint> = places
        .iter()
        .zip(at)
        .zip(depths)
        .map(|((place, at), virtual_depth)| {
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
    let labels = [("u", whole(|p| p.x)), ("v", whole(|p| p.y))];
    let has_std_devs = std_dev[2] > 0.0;
    let findings = without_std_devs(has_std_devs).into_iter().collect();
    Ok(Cloud { points, labels, has_std_devs, findings })
}

/// A note that no σ of points is known.
fn without_std_devs(known: bool) -> Option<Finding> {
    (!known).then(|| Finding::note(Issue::PointsWithoutSigma))
}

/// Why no virtual depth gives a point.
fn no_point(findings: &[Finding]) -> String {
    let told: Vec<String> = findings
        .iter()
        .filter(|finding| finding.severity > Severity::Note)
        .map(ToString::to_string)
        .collect();
    if told.is_empty() {
        "no point: are the virtual depths of this camera, counted from the array and positive behind it? Beyond the focal \
         length of the main lens are those of images that it makes"
            .to_owned()
    } else {
        format!("no point:\n  {}", told.join("\n  "))
    }
}

fn columns(cloud: &Cloud) -> Vec<PlyColumn<'static>> {
    let points = || cloud.points.iter().flatten();
    let coordinate = |axis: usize| points().map(|p| p.point_mm[axis]).collect();
    let std_dev = |axis: usize| points().map(|p| p.std_devs_mm()[axis]).collect();
    let mut columns = vec![
        PlyColumn::Float("x", coordinate(0)),
        PlyColumn::Float("y", coordinate(1)),
        PlyColumn::Float("z", coordinate(2)),
    ];
    if cloud.has_std_devs {
        let names = ["sigma_x", "sigma_y", "sigma_z"];
        columns.extend((0..).zip(names).map(|(axis, name)| PlyColumn::Float(name, std_dev(axis))));
    }
    for (name, labels) in &cloud.labels {
        let kept = labels.iter().zip(&cloud.points).filter(|(_, point)| point.is_some());
        columns.push(PlyColumn::Int(name, kept.map(|(label, _)| *label).collect()));
    }
    columns
}

fn write_csv(out: &mut dyn Write, cloud: &Cloud) -> std::io::Result<()> {
    let [(first, firsts), (second, seconds)] = &cloud.labels;
    let names = if cloud.has_std_devs { ",sigma_x_mm,sigma_y_mm,sigma_z_mm" } else { "" };
    writeln!(out, "{first},{second},x_mm,y_mm,z_mm{names}")?;
    for ((point, a), b) in cloud.points.iter().zip(firsts).zip(seconds) {
        let Some(point) = point else { continue };
        let ([x, y, z], [sx, sy, sz]) = (point.point_mm, point.std_devs_mm());
        write!(out, "{a},{b},{x:.6},{y:.6},{z:.6}")?;
        if cloud.has_std_devs {
            write!(out, ",{sx:.6},{sy:.6},{sz:.6}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn document(arguments: &Arguments, cloud: &Cloud) -> Value {
    let points = || cloud.points.iter().flatten();
    let depths = || points().map(|p| p.point_mm[2]).collect::<Vec<f64>>();
    let median = |axis: usize| {
        let known = cloud.has_std_devs;
        known.then(|| quantile(points().map(|p| p.std_devs_mm()[axis]).collect(), 0.5))
    };
    json!({
        "input": arguments.input.display().to_string(),
        "camera": arguments.camera.display().to_string(),
        "points": points().count(),
        "without_point": cloud.points.iter().filter(|point| point.is_none()).count(),
        "distance_mm": { "near": quantile(depths(), 0.05), "median": quantile(depths(), 0.5), "far": quantile(depths(), 0.95) },
        "findings": cloud.findings,
        "median_sigma_mm": { "x": median(0), "y": median(1), "z": median(2) },
    })
}

/// The value that a part of all values are below; NaN without any.
fn quantile(mut values: Vec<f64>, part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within the values
    let index = (part * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(index).copied().unwrap_or(f64::NAN)
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
            "Their σ by what was measured is {:.3} mm across the axis and {:.3} mm along it (median); that of the camera \
             comes on top.",
            number(&sigma["x"]).hypot(number(&sigma["y"])) / std::f64::consts::SQRT_2,
            number(&sigma["z"]),
        ));
    }
    lines.join("\n")
}

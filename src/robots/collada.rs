//! Triangles of COLLADA 1.4 (DAE), posed by the file's scene, in metres. The file's up axis is ignored, as in RViz,
//! because files of robots are made for this.

use super::files::SourceFile;
use super::xml_bounds;
use crate::error::{Error, Result};
use nalgebra::{Matrix4, Point3, Rotation3, Unit, Vector3};
use roxmltree::Node;
use std::collections::HashMap;

/// Largest number of triangles of a mesh: our choice, because the largest mesh that we have seen (the trunk of
/// go1.urdf) has 307,000.
pub const MOST_TRIANGLES: usize = 500_000;

type Triangle = [Vector3<f64>; 3];

/// Largest number of XML nodes, and of nodes in a scene with all instances: our choice, to bound time and memory.
const MOST_NODES: u32 = 1_000_000;
const MOST_PLACES: usize = 10_000;
/// Deepest nesting of a scene's nodes: our choice, to bound the recursion.
const DEEPEST: usize = 60;

struct ColladaReader<'a> {
    source: &'a SourceFile,
    by_id: HashMap<&'a str, Node<'a, 'a>>,
    places: usize,
    triangles: Vec<Triangle>,
}

pub fn read(source: &SourceFile) -> Result<Vec<Triangle>> {
    xml_bounds::check(source.text()?).map_err(|reason| Error::file(&source.path, reason))?;
    let options = roxmltree::ParsingOptions { allow_dtd: false, nodes_limit: MOST_NODES, ..Default::default() };
    let (text, _) = source.xml()?;
    let document = roxmltree::Document::parse_with_options(&text, options)
        .map_err(|e| Error::file(&source.path, format!("no COLLADA: {e}; download or export it again")))?;
    let root = document.root_element();
    let ids = root.descendants().filter_map(|n| n.attribute("id").map(|id| (id, n)));
    let mut reader = ColladaReader { source, by_id: ids.collect(), places: 0, triangles: Vec::new() };
    let unit = find(root, "asset").and_then(|a| find(a, "unit")).and_then(|u| u.attribute("meter"));
    let unit = unit.map_or(Ok(1.0), |m| reader.number(m))?;
    let scale = Matrix4::new_scaling(unit);
    let scene = find(root, "scene").and_then(|s| find(s, "instance_visual_scene")).and_then(|i| i.attribute("url"));
    match scene {
        Some(url) => reader.node(reader.named(url)?, &scale, 0)?,
        None => {
            for geometry in root.descendants().filter(|n| n.has_tag_name_any("geometry")) {
                reader.geometry(geometry, &scale)?;
            }
        }
    }
    Ok(reader.triangles)
}

/// Compares names without their name space, because files have the name space of version 1.4, the name space of version 1.5, or none.
trait Tagged {
    fn has_tag_name_any(&self, name: &str) -> bool;
}

impl Tagged for Node<'_, '_> {
    fn has_tag_name_any(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}

fn find<'a>(node: Node<'a, 'a>, name: &str) -> Option<Node<'a, 'a>> {
    node.children().find(|c| c.has_tag_name_any(name))
}

impl<'a> ColladaReader<'a> {
    fn wrong(&self, reason: impl std::fmt::Display) -> Error {
        Error::file(&self.source.path, reason)
    }

    fn named(&self, url: &str) -> Result<Node<'a, 'a>> {
        let id = url.strip_prefix('#').unwrap_or(url);
        self.by_id.get(id).copied().ok_or_else(|| self.wrong(format!("nothing has the id {id:?}")))
    }

    fn number(&self, word: &str) -> Result<f64> {
        word.trim().parse().map_err(|_| self.wrong(format!("{word:?} is no number")))
    }

    fn numbers(&self, node: Node) -> Result<Vec<f64>> {
        node.text().unwrap_or_default().split_ascii_whitespace().map(|w| self.number(w)).collect()
    }

    fn fixed<const N: usize>(&self, node: Node) -> Result<[f64; N]> {
        let list = self.numbers(node)?;
        let count = list.len();
        let name = node.tag_name().name();
        list.try_into().map_err(|_| self.wrong(format!("<{name}> has {count} numbers in place of {N}")))
    }

    /// Adds the triangles of a scene, or of one of its nodes with all nodes below.
    fn node(&mut self, node: Node<'a, 'a>, above: &Matrix4<f64>, depth: usize) -> Result<()> {
        self.places += 1;
        if depth > DEEPEST || self.places > MOST_PLACES {
            return Err(self.wrong(format!("a scene deeper than {DEEPEST} or of more than {MOST_PLACES} nodes")));
        }
        let mut at = *above;
        for child in node.children().filter(Node::is_element) {
            match child.tag_name().name() {
                "matrix" => at *= Matrix4::from_row_slice(&self.fixed::<16>(child)?),
                "translate" => at *= Matrix4::new_translation(&self.fixed::<3>(child)?.into()),
                "scale" => at *= Matrix4::new_nonuniform_scaling(&self.fixed::<3>(child)?.into()),
                "rotate" => {
                    let [x, y, z, degrees] = self.fixed::<4>(child)?;
                    if let Some(axis) = Unit::try_new(Vector3::new(x, y, z), 0.0) {
                        at *= Rotation3::from_axis_angle(&axis, degrees.to_radians()).to_homogeneous();
                    }
                }
                "node" => self.node(child, &at, depth + 1)?,
                "instance_node" => {
                    let url = child.attribute("url").unwrap_or_default();
                    self.node(self.named(url)?, &at, depth + 1)?;
                }
                "instance_geometry" => {
                    let url = child.attribute("url").unwrap_or_default();
                    self.geometry(self.named(url)?, &at)?;
                }
                "instance_controller" | "lookat" | "skew" => {
                    return Err(self.wrong(format!("<{}> is not read", child.tag_name().name())));
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn geometry(&mut self, geometry: Node<'a, 'a>, at: &Matrix4<f64>) -> Result<()> {
        self.places += 1;
        let Some(mesh) = find(geometry, "mesh") else { return Ok(()) };
        for part in mesh.children().filter(Node::is_element) {
            match part.tag_name().name() {
                "triangles" | "polylist" | "polygons" => self.faces(part, at)?,
                "tristrips" | "trifans" => {
                    return Err(self.wrong(format!("<{}> is not read: export plain triangles", part.tag_name().name())));
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn faces(&mut self, part: Node<'a, 'a>, at: &Matrix4<f64>) -> Result<()> {
        let inputs = part.children().filter(|c| c.has_tag_name_any("input"));
        let offset = |n: &Node| n.attribute("offset").and_then(|o| o.parse::<usize>().ok()).unwrap_or(0);
        // Our choice of the bound: a larger offset is a mistake, and the sum must not overflow.
        let stride = inputs.clone().map(|n| offset(&n)).max().unwrap_or(0).min(100) + 1;
        let Some(vertex) = inputs.clone().find(|n| n.attribute("semantic") == Some("VERTEX")) else {
            return Err(self.wrong("a mesh without vertices"));
        };
        let points = self.points(vertex.attribute("source").unwrap_or_default(), at)?;
        let counts: Option<Vec<f64>> = find(part, "vcount").map(|n| self.numbers(n)).transpose()?;
        let mut corners = Vec::new();
        for p in part.children().filter(|c| c.has_tag_name_any("p")) {
            let words = p.text().unwrap_or_default().split_ascii_whitespace();
            corners.clear();
            for word in words.skip(offset(&vertex)).step_by(stride) {
                let point = word.parse::<usize>().ok().and_then(|i| points.get(i).copied());
                corners.push(point.ok_or_else(|| self.wrong(format!("{word:?} is no vertex")))?);
            }
            let own = [corners.len() as f64];
            let threes;
            let sizes: &[f64] = match (part.tag_name().name(), &counts) {
                ("triangles", _) => {
                    threes = vec![3.0; corners.len() / 3];
                    &threes
                }
                (_, Some(counts)) => counts,
                _ => &own,
            };
            let mut from = 0;
            for size in sizes {
                let to = from + *size as usize;
                let polygon = corners.get(from..to).ok_or_else(|| self.wrong("a polygon lacks vertices"))?;
                for k in 1..polygon.len().saturating_sub(1) {
                    self.triangles.push([polygon[0], polygon[k], polygon[k + 1]]);
                }
                from = to;
            }
            if self.triangles.len() > MOST_TRIANGLES {
                return Err(self.wrong(format!("more than {MOST_TRIANGLES} triangles")));
            }
        }
        Ok(())
    }

    /// The positions that `<vertices>` or a source refers to.
    fn points(&self, url: &str, at: &Matrix4<f64>) -> Result<Vec<Vector3<f64>>> {
        let mut node = self.named(url)?;
        if node.has_tag_name_any("vertices") {
            let position = node.children().find(|n| n.attribute("semantic") == Some("POSITION"));
            node = self.named(position.and_then(|p| p.attribute("source")).unwrap_or_default())?;
        }
        let Some(array) = find(node, "float_array") else { return Err(self.wrong("a source without numbers")) };
        let numbers = self.numbers(array)?;
        let whole = numbers.chunks_exact(3).map(|p| at.transform_point(&Point3::new(p[0], p[1], p[2])).coords);
        Ok(whole.collect())
    }
}
